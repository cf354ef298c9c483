"""Generated grasps as a data set: every grasp is a frame of a sequence, that of its object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from grabnet.analysis.data_set import DataSet, Surface, check_label
from grabnet.analysis.frames import Frames, Group, Solid
from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.body.skeleton import RIGHT_HAND_PARTS
from grabnet.cli.checks import Count, Distance, Name, in_range
from grabnet.contact.bones import Bones
from grabnet.contact.hands import HandAnnotator
from grabnet.contact.rules import ContactRules
from grabnet.data.objects import object_files
from grabnet.errors import UserError
from grabnet.evaluation.generated import read_grasps
from grabnet.geometry.mesh import load_mesh
from grabnet.io.files import existing, sha256


@dataclass(frozen=True)
class GeneratedGrasps(DataSet):
    """Right-hand grasps in a folder as `grabnet.evaluation.generated` reads it.

    Args:
        label: names the data set in the report.
        root: folder of grasps, a folder for each object.
        meshes: folder of the objects' meshes.
        hand_file: MANO's right hand; the open one when omitted.
        n: grasps of each object, at most.
        contact_distance: ε of the annotation, metres.
        rules: what ε is measured to, and whose part it is.
    """

    label: Name
    root: Name
    meshes: Name
    hand_file: Name | None
    n: Count
    contact_distance: Distance
    rules: ContactRules
    is_synthetic = True

    def __post_init__(self):
        in_range(self, "compare.")
        check_label(self.label)

    @cached_property
    def folder(self) -> Path:
        return Path(self.root).resolve()

    def names(self) -> list[str]:
        names = [name for name in self.objects() if (existing(self.folder, "Folder of grasps") / name).is_dir()]
        if not names:
            raise UserError(f"{self.folder} holds no folder that is called like an object of {self.meshes}.")
        return names

    def objects(self) -> Mapping[str, Path]:
        return self._objects

    def hand(self) -> HandModel:
        return self._hand

    def recipe(self) -> dict[str, Any]:
        rules = {"contact_distance": self.contact_distance, "contact_rules": asdict(self.rules), "n": self.n}
        return rules | {"models": {"hand": sha256(self._hand_path)}}

    @torch.no_grad()
    def frames(self, name: str) -> tuple[Frames, dict[str, str]]:
        file, hand = self.objects()[name], self.hand()
        found = read_grasps(self.folder, name, file, hand, self.n)
        if found.vertices.shape[1] != len(hand.v_template):
            raise UserError(
                f"{self.folder / name} holds hands of {found.vertices.shape[1]} vertices, the hand model has "
                f"{len(hand.v_template)}: their fingers are unknown."
            )
        mesh, parts = load_mesh(file, weld=False), self.surface.parts
        annotate = HandAnnotator(
            mesh,
            found.vertices[0],
            hand.faces.numpy(),
            parts,
            self.contact_distance,
            self.rules,
            Bones.of(hand, hand.v_template.numpy(), RIGHT_HAND_PARTS),
        )
        maps, vertices = annotate(found.vertices), torch.as_tensor(found.vertices)
        frames = Frames(
            name=name,
            group=Group("", "", name),
            object=maps.object,
            body=maps.hand,
            lift=np.full(len(found), np.inf),
            surfaces={"hands": [lambda chosen: vertices[chosen]]},
            solid=lambda: Solid(mesh),
            hand_length=float(np.ptp(hand.v_template.numpy(), 0).max()),
        )
        files = [path for path in sorted((self.folder / name).iterdir()) if path.is_file()]
        read = {str(path.relative_to(self.folder)): sha256(path) for path in files}
        return frames, read | {str(file.resolve()): sha256(file)}

    @cached_property
    def surface(self) -> Surface:
        hand = self.hand()
        parts = np.array(RIGHT_HAND_PARTS, np.uint8)[Anatomy.of(hand).bone.numpy()]
        return Surface(hand.v_template.numpy(), hand.faces.numpy(), parts, np.arange(len(parts)))

    @cached_property
    def _objects(self) -> dict[str, Path]:
        return object_files(existing(self.meshes, "Folder of meshes (compare.meshes)"))

    @cached_property
    def _hand(self) -> HandModel:
        return HandModel(self._hand_path)

    @property
    def _hand_path(self) -> Path:
        return OPEN_HANDS / "MANO_RIGHT.npz" if self.hand_file is None else existing(self.hand_file, "Hand model")
