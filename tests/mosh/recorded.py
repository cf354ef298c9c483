"""Recordings in GRAB's layout, of the open body with a ball, whatever it is called, in its right hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
import trimesh

from grabnet.body.skeleton import JOINTS
from grabnet.body.whole import BodyParameters
from grabnet.contact.sequences import annotate
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import Sequence, write_sequence
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.mosh.assembling import TABLE_MESH, assemble
from grabnet.mosh.attachment import Pose
from grabnet.mosh.rigid import RigidMotion
from grabnet.mosh.subjects import Subject
from tests.mosh.conftest import Actor

_RIGHT_HAND = slice(40, 55)
_TIPS = [JOINTS.index(f"right_{finger}3") for finger in ("thumb", "index")]
RATE = 24.0
_DEEPER = 0.003  # metres that the ball reaches into thumb and index finger


def record(root: Path, actors: dict[str, Actor]) -> None:
    """Write a recording of each actor, by name of the recording, with all meshes that it names; `RATE` frames/s."""
    for name, actor in actors.items():
        who, _, take = name.partition("/")
        subject, object_name = Subject(who, "male", None, None), take.partition("_")[0]
        template = actor.body.v_template
        rotations = actor.rotations.float().clone()
        rotations[:, _RIGHT_HAND] = axis_angle_to_matrix(subject.hand("right").hands_mean.view(15, 3))
        vertices = actor.body(BodyParameters.from_rotations(rotations, actor.transl.float())).vertices
        thumb, index = (vertices[:, actor.body.weights[:, joint].argmax()] for joint in _TIPS)
        radius = (thumb - index).norm(dim=-1).mean().item() / 2 + _DEEPER
        sphere = trimesh.creation.icosphere(4, radius)
        ball = Mesh(sphere.vertices, sphere.faces)
        n = len(rotations)
        motion = RigidMotion(
            torch.eye(3).double().expand(n, 3, 3), ((thumb + index) / 2).double(), torch.ones(n).bool(),
            torch.zeros(n).bool(), torch.zeros(n, 8),
        )  # fmt: skip
        pose = Pose(rotations, actor.transl.float(), torch.zeros(n, 0))
        sequence = assemble(name, subject, template, pose, RATE, object_name, motion, ball)
        sequence = _labelled(sequence, actor, ball)
        write_sequence(root / "grab" / f"{name}.npz", sequence)
        subject.write(root, template)
        top = trimesh.creation.box((1, 1, 0.02))
        for path, mesh in ((OBJECT_MESHES / f"{object_name}.ply", ball), (TABLE_MESH, Mesh(top.vertices, top.faces))):
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            save_mesh(root / path, mesh)


def _labelled(sequence: Sequence, actor: Actor, ball: Mesh) -> Sequence:
    annotation = annotate(sequence, actor.body, actor.body.v_template, ball)
    assert (annotation.labels.object > 0).any(1).all(), "the ball is held in every frame"
    return replace(sequence, contact=annotation.labels)
