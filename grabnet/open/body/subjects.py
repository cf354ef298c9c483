"""The ten people of the open sequences: the open body in their shapes, with the hands of the open grasps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from grabnet.body.hand import HandModel
from grabnet.body.skeleton import LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS
from grabnet.body.whole import OPEN_BODY, BodyModel
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.io.npz import read_npz
from grabnet.open.body.gluing import Gluing
from grabnet.open.grasps.store import OpenGrasps

_REFLECT = np.array([-1, 1, 1], np.float32)


@dataclass(frozen=True)
class Subject:
    """A person at rest: v_template (V, 3) of the body, rhand and lhand (778, 3) of the hands alone, metres."""

    name: str
    gender: str
    v_template: np.ndarray
    rhand: np.ndarray
    lhand: np.ndarray

    def file(self, part: str = "") -> str:
        """Path of a template below GRAB's root; part is "", "_rhand" or "_lhand"."""
        return f"tools/subject_meshes/{self.gender}/{self.name}{part}.ply"


def open_subjects(body: BodyModel, grasps: OpenGrasps) -> list[Subject]:
    """Subjects with the hand shapes of `grasps`, each on the body of an adult with such hands.

    The body's hand is the hand model's, at full resolution; wrist and forearm follow it within 8 cm.
    """
    stored = read_npz(OPEN_BODY / "subjects.npz")
    hand = HandModel.open()
    faces, template = body.faces.numpy(), body.v_template.numpy()
    sides = (("right_hand", RIGHT_HAND_JOINTS[0], np.ones(3)), ("left_hand", LEFT_HAND_JOINTS[0], _REFLECT))
    gluings = [Gluing(template, faces, stored[name]) for name, *_ in sides]
    subjects = []
    for name, gender, betas, own in zip(grasps.subjects, grasps.genders, grasps.betas, stored["betas"], strict=True):
        v_template = body.shaped(torch.as_tensor(own)).numpy()
        wrist = body.rest_joints(torch.as_tensor(v_template)).numpy()
        rhand = hand.shaped(betas).numpy()
        shape = stored["hand_template"] + stored["hand_shapedirs"] @ betas.numpy()
        shape += rhand[0] - shape[_first(stored)]  # in the hand model's frame
        origin = hand.rest_joints(torch.as_tensor(rhand))[0].numpy()
        for glue, (_, joint, reflect) in zip(gluings, sides, strict=True):
            v_template = glue(v_template, (shape - origin) * reflect + wrist[joint])
        subjects.append(Subject(name, gender, v_template.astype(np.float32), rhand, rhand * _REFLECT))
    return subjects


def write_subjects(root: Path, body: BodyModel, subjects: list[Subject]) -> None:
    """Write each subject's body and hands where GRAB keeps its own."""
    faces = {"": body.faces, "_rhand": HandModel.open().faces, "_lhand": HandModel.open("left").faces}
    for subject in subjects:
        for part, vertices in (("", subject.v_template), ("_rhand", subject.rhand), ("_lhand", subject.lhand)):
            path = root / subject.file(part)
            path.parent.mkdir(parents=True, exist_ok=True)
            save_mesh(path, Mesh(vertices, faces[part].numpy()))


def _first(stored: dict[str, np.ndarray]) -> int:
    """Where the hand model's first vertex is among the hand's at full resolution."""
    return int((stored["right_hand"] == stored["rhand_vertices"][0]).argmax())
