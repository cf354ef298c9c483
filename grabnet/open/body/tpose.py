"""From bodies as modelled to SMPL-X's rest pose: arms straight out to the sides, palms down, legs as they stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from grabnet.body.skeleton import JOINTS
from grabnet.open.body.bones import bone_of
from grabnet.open.body.source import AdultBodies


@dataclass(frozen=True)
class RestBodies:
    """N bodies in rest pose: metres, y up, facing +z, left arm along +x. vertices (N, V, 3), joints (N, 55, 3)."""

    vertices: np.ndarray
    joints: np.ndarray


def to_rest_pose(bodies: AdultBodies) -> RestBodies:
    """Turn arms and hands with MakeHuman's own skinning; fingers follow the palm."""
    vertices, heads = _y_up(bodies.vertices), _y_up(bodies.heads)
    bones = {name: k for k, name in enumerate(bodies.bones)}
    children: dict[int, list[int]] = {}
    for bone, parent in enumerate(bodies.parents):
        children.setdefault(parent, []).append(bone)
    rotation = np.tile(np.eye(3), (len(vertices), len(bones), 1, 1))

    def turn(bone: str, to: np.ndarray) -> None:
        """Turn a bone, and with it all that hangs on it."""
        below = [bones[bone]]
        while below:
            rotation[:, (k := below.pop())] = to
            below += children.get(k, [])

    for side, outward in (("R", -1.0), ("L", 1.0)):
        shoulder, elbow, wrist, index, middle, pinky = (
            heads[:, bones[f"{name}.{side}"]]
            for name in ("upperarm01", "lowerarm01", "wrist", "finger2-1", "finger3-1", "finger5-1")
        )
        out = np.broadcast_to([outward, 0, 0], elbow.shape)
        hinge = np.cross(elbow - shoulder, wrist - elbow)  # turning about it bends the elbow: forwards, in rest pose
        to_hinge = np.broadcast_to([0, -outward, 0], elbow.shape)
        upper = _frame(out, to_hinge) @ _frame(elbow - shoulder, hinge).swapaxes(1, 2)
        lower = _frame(out, to_hinge) @ _frame(wrist - elbow, hinge).swapaxes(1, 2)
        palm = np.cross(index - wrist, pinky - wrist) * -outward
        hand = _frame(out, np.broadcast_to([0, -1.0, 0], out.shape)) @ _frame(middle - wrist, palm).swapaxes(1, 2)
        twist = Rotation.from_matrix(lower.swapaxes(1, 2) @ hand).as_rotvec()
        for bone, to in (
            ("upperarm01", upper),
            ("lowerarm01", lower),
            ("lowerarm02", lower @ Rotation.from_rotvec(twist / 2).as_matrix()),
            ("wrist", hand),
        ):
            turn(f"{bone}.{side}", to)

    position = np.zeros_like(heads)
    for bone, parent in enumerate(bodies.parents):
        step = heads[:, bone] - heads[:, parent]
        position[:, bone] = (
            heads[:, bone] if parent < 0 else position[:, parent] + np.einsum("nij,nj->ni", rotation[:, parent], step)
        )
    offset = position - np.einsum("nbij,nbj->nbi", rotation, heads)
    motion = np.concatenate([rotation, offset[..., None]], -1).reshape(len(vertices), len(bones), 12)
    posed = np.empty_like(vertices)
    for n, body in enumerate(vertices):
        blend = (bodies.weights @ motion[n]).reshape(-1, 3, 4)
        posed[n] = np.einsum("vij,vj->vi", blend[..., :3], body) + blend[..., 3]
    return RestBodies(posed, position[:, [bones[bone_of(joint)] for joint in JOINTS]])


def _y_up(points: np.ndarray) -> np.ndarray:
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], -1).astype(np.float64)


def _frame(along: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """(N, 3, 3) columns: along, beside made perpendicular to it, and their cross product."""
    along = along / np.linalg.norm(along, axis=-1, keepdims=True)
    beside = beside - (beside * along).sum(-1, keepdims=True) * along
    beside = beside / np.linalg.norm(beside, axis=-1, keepdims=True)
    return np.stack([along, beside, np.cross(along, beside)], -1)
