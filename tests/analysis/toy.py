"""Sequences made of random labels, to count by hand."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from grabnet.analysis.frames import Frames, Group, Solid
from grabnet.analysis.rules import Rules
from grabnet.geometry.mesh import Mesh

BOX = np.array([0.06, 0.08, 0.1])  # metres, sides of the object
RULES = Rules(
    min_lift=0.005,
    min_body_vertices=5,
    posed_every=2,
    lifts=[0.0, 0.005, 0.02],
    finger_vertices=[1, 2, 4],
    clusters=3,
    grasps_per_sequence=8,
    grasps_per_object=12,
    seed=0,
)
GROUPS = [
    Group("use", "s1", "cubesmall"),
    Group("use", "s2", "cubelarge"),
    Group("pass", "s1", "cubesmall"),
    Group("lift", "s2", "spheresmall"),
]


def box() -> Mesh:
    made = trimesh.creation.box(BOX)
    return Mesh(made.vertices, made.faces)


def sequence(k: int, n: int = 40, touching: bool = True) -> Frames:
    """A sequence of the k-th group: n frames, an object of 30 vertices and a body of 60; points for hands."""
    rng = np.random.default_rng(k)
    labels = [np.where(rng.random((n, v)) < 0.2 * touching, rng.integers(1, 56, (n, v)), 0) for v in (30, 60)]
    right, left, head = (torch.tensor(rng.uniform(-0.06, 0.06, (n, 20, 3)), dtype=torch.float32) for _ in range(3))
    return Frames(
        name=f"{GROUPS[k].subject}/{GROUPS[k].object}_{GROUPS[k].intent}_1",
        group=GROUPS[k],
        object=labels[0].astype(np.uint8),
        body=labels[1].astype(np.uint8),
        lift=rng.uniform(-0.03, 0.03, n).astype(np.float32),
        surfaces={
            "hands": [lambda chosen: right[chosen], lambda chosen: left[chosen]],
            "head": [lambda chosen: head[chosen]],
        },
        solid=lambda: Solid(box()),
        hand_length=0.17 + 0.01 * int(GROUPS[k].subject[1]),
    )


def is_contact(frames: Frames, t: int, lift: float = RULES.min_lift) -> bool:
    """Whether a frame is one of the paper's contact frames, counted vertex by vertex."""
    return abs(frames.lift[t]) >= lift and sum(label > 0 for label in frames.body[t]) >= RULES.min_body_vertices


def has(frames: Frames, t: int, parts, least: int = 1) -> bool:
    """Whether so many vertices of the object have one of these labels."""
    return sum(label in parts for label in frames.object[t]) >= least
