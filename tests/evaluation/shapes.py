"""Balls and boxes in the place of objects and hands: their overlap has closed forms."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from grabnet.body.hand import HandModel, HandParameters
from grabnet.evaluation.hands import HandLabels, Hands
from grabnet.evaluation.scene import GraspScene, GraspTarget
from grabnet.geometry.mesh import Mesh

# Metres: distance of contact.
EPSILON = 0.0045


def ball(radius: float, subdivisions: int = 4) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions, radius)
    return Mesh(made.vertices, made.faces)


def moved(mesh: Mesh, *offsets: tuple[float, float, float]) -> Hands:
    """The mesh as a hand in several places."""
    vertices = np.stack([mesh.vertices + np.array(offset, np.float32) for offset in offsets])
    return Hands(vertices=vertices.astype(np.float32), faces=mesh.faces.astype(np.int64))


def scene(mesh: Mesh, hands: Hands, truth: Hands | None = None) -> GraspScene:
    return GraspScene(GraspTarget(mesh), hands, truth)


def posed(hand: HandModel, n: int = 1, **angles: float) -> Hands:
    """The open hand, flat but for some anatomical angles."""
    anatomy = HandLabels.of(hand).anatomy
    values = torch.zeros(n, 21)
    for name, value in angles.items():
        values[:, anatomy.angle_names.index(name)] = value
    pose = anatomy.hand_pose(values)
    parameters = HandParameters(torch.eye(3).expand(n, 3, 3), pose, torch.zeros(n, 3))
    return Hands(vertices=hand(parameters).vertices.numpy(), faces=hand.faces.numpy(), hand_pose=pose.numpy())
