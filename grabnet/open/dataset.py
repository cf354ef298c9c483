"""The open data set: synthesised grasps of the open hand on the open objects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.cli.checks import Seed, Weight
from grabnet.data.sources.base import FrameSource, HandFrames
from grabnet.geometry.rotations import about_z, axis_angle_to_matrix
from grabnet.io.files import sha256
from grabnet.open.grasps.store import OPEN_GRASPS, OpenGrasps, load_open_grasps
from grabnet.open.objects.writing import FORMAT as OBJECTS_FORMAT
from grabnet.open.objects.writing import write_objects

# Raise it when the same grasps, tilt and seed would give other frames.
FORMAT = 1


class OpenData(FrameSource):
    """The shipped grasps, each object and its hand turned together to any heading.

    Args:
        root: folder of the data set, where missing meshes of the objects are made.
        tilt: deviation of the random lean that a held object and its hand get together, radians per horizontal axis;
            grasps of objects standing on a table are left upright.
        seed: of lean and heading.
    """

    def __init__(self, root: str, tilt: Weight, seed: Seed):
        self.root = Path(root)
        self.tilt = tilt
        self.seed = seed
        self.hand = HandModel.open()

    def recipe(self) -> dict[str, Any]:
        return {
            "source": "open grasps",
            "format": FORMAT,
            "objects": OBJECTS_FORMAT,
            "grasps_sha256": sha256(OPEN_GRASPS),
            "tilt": self.tilt,
            "seed": self.seed,
        }

    def objects(self) -> Mapping[str, Path]:
        return {path.stem: path for path in write_objects(self.root)}

    def subjects(self) -> Mapping[str, Tensor]:
        return dict(zip(self._grasps.subjects, self.hand.shaped(self._grasps.betas), strict=True))

    def sequences(self) -> Iterable[str]:
        pairs = torch.stack([self._grasps.object, self._grasps.subject], 1).unique(dim=0).tolist()
        return [f"{self._grasps.subjects[s]}/{self._grasps.objects[o]}_grasp_1" for o, s in pairs]

    def read(self, sequence: str) -> HandFrames:
        grasps = self._grasps
        subject, _, take = sequence.partition("/")
        name = take.removesuffix("_grasp_1")
        is_shown = (grasps.object == grasps.objects.index(name)) & (grasps.subject == grasps.subjects.index(subject))
        index = is_shown.nonzero().squeeze(1)
        attitude = self._attitudes(index, f"{subject}/{name}")
        held = grasps.parameters(self._anatomy, index)
        return HandFrames(
            subject=subject,
            object=name,
            intent="grasp",
            frame=torch.arange(len(index)),
            hand=self.hand.moved(held, attitude, rest=self.subjects()[subject]),
            object_rotation=attitude,
            object_transl=torch.zeros(len(index), 3),
        )

    @cached_property
    def _grasps(self) -> OpenGrasps:
        return load_open_grasps()

    @cached_property
    def _anatomy(self) -> Anatomy:
        return Anatomy.of(self.hand)

    def _attitudes(self, index: Tensor, name: str) -> Tensor:
        """(N, 3, 3) rotations from the object's frame to the world: any heading, and a lean unless on a table."""
        digest = int(sha256(name)[:8], 16)
        generator = torch.Generator().manual_seed(hash((self.seed, digest)))
        heading = 2 * np.pi * torch.rand(len(index), generator=generator)
        lean = self.tilt * torch.randn(len(index), 3, generator=generator)
        lean[:, 2] = 0
        lean[self._grasps.clears_table[index]] = 0
        return axis_angle_to_matrix(lean) @ about_z(heading)
