"""The open data set on disk: open objects and synthesised grasps, laid out as GRAB and its frames are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.data.frames import finish_store, is_made_by, write_shard
from grabnet.data.objects import OBJECT_MESHES
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.rotations import about_z, axis_angle_to_matrix, matrix_to_axis_angle
from grabnet.io.files import sha256
from grabnet.io.provenance import provenance
from grabnet.open.grasps.store import OPEN_GRASPS, OpenGrasps, load_open_grasps
from grabnet.open.objects.writing import write_objects


class OpenDataset:
    """Writes what is missing of the open data set when called.

    Args:
        root: folder of the data set.
        tilt: deviation of the random lean that a held object and its hand get together, radians per horizontal axis;
            grasps of objects standing on a table are left upright.
        seed: of lean and heading.
    """

    def __init__(self, root: str, tilt: float, seed: int):
        self.root, self.tilt, self.seed = Path(root), tilt, seed

    def __call__(self) -> None:
        recipe = {"grasps_sha256": sha256(OPEN_GRASPS), "tilt": self.tilt, "seed": self.seed}
        if is_made_by(self.root / "frames", recipe):
            return
        write_objects(self.root)
        grasps = load_open_grasps()
        hand = HandModel.open()
        anatomy = Anatomy.of(hand)
        v_template = hand.shaped(grasps.betas)
        for number, name in enumerate(grasps.objects):
            centroid = torch.as_tensor(load_mesh(self.root / OBJECT_MESHES / f"{name}.ply").centroid)
            for subject, subject_name in enumerate(grasps.subjects):
                index = ((grasps.object == number) & (grasps.subject == subject)).nonzero().squeeze(1)
                if not len(index):
                    continue
                attitude = self._attitudes(grasps, index, f"{subject_name}/{name}")
                held = grasps.parameters(anatomy, index)
                moved = hand.moved(held, attitude, -(attitude @ centroid), v_template[subject])
                values = {
                    "global_orient": matrix_to_axis_angle(moved.global_orient),
                    "hand_pose": matrix_to_axis_angle(moved.hand_pose).flatten(1),
                    "transl": moved.transl,
                    "object_orient": matrix_to_axis_angle(attitude),
                    "frame": torch.arange(len(index)),
                }
                sequence = f"{subject_name}/{name}_grasp_1"
                write_shard(self.root / "frames", sequence, subject_name, name, values, intent="grasp")
        by_name = dict(zip(grasps.subjects, v_template, strict=True))
        finish_store(self.root / "frames", by_name, grasps.objects, provenance(source="open grasps", recipe=recipe))

    def _attitudes(self, grasps: OpenGrasps, index: torch.Tensor, name: str) -> torch.Tensor:
        """(N, 3, 3) rotations from the object's frame to the world: any heading, and a lean unless on a table."""
        digest = int(sha256(name)[:8], 16)
        generator = torch.Generator().manual_seed(hash((self.seed, digest)))
        heading = 2 * np.pi * torch.rand(len(index), generator=generator)
        lean = self.tilt * torch.randn(len(index), 3, generator=generator)
        lean[:, 2] = 0
        lean[grasps.clears_table[index]] = 0
        return axis_angle_to_matrix(lean) @ about_z(heading)
