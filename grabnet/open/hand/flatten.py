"""From hands as modelled to the rest pose: flat, in the hand's own frame, with MANO's sixteen joints."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from grabnet.body.skeleton import HAND_JOINTS
from grabnet.open.hand.source import BONES, AdultHands

_FINGER_NUMBERS = {"thumb": 1, "index": 2, "middle": 3, "ring": 4, "pinky": 5}  # MakeHuman's


@dataclass(frozen=True)
class FlatHands:
    """N right hands in rest pose: wrist joint at the origin, fingers along −x, palm towards −y, thumb towards +z.

    vertices (N, V, 3) metres; faces (F, 3); joints (N, 16, 3) in MANO's order; weights (V, 16), rows sum to 1.
    """

    vertices: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray


def flatten(hands: AdultHands) -> FlatHands:
    """Straighten fingers and wrist with MakeHuman's own skinning; the thumb keeps its modelled pose.

    Finger weights go to their MANO joints; palm and forearm go to the wrist.
    """

    def head(bone: str) -> np.ndarray:
        return hands.heads[:, BONES.index(bone)]

    def tail(bone: str) -> np.ndarray:
        return hands.tails[:, BONES.index(bone)]

    to_frame = _hand_rotation(head, tail)
    # Global rotation of each bone from its modelled to its flat direction.
    rotation = dict.fromkeys(BONES, to_frame)
    forearm = np.einsum("nij,nj->ni", to_frame, head("wrist") - head("lowerarm01"))
    bend = _swing(forearm, np.array([-1.0, 0, 0]))
    rotation["lowerarm01"] = bend @ to_frame
    half = Rotation.from_rotvec(Rotation.from_matrix(bend).as_rotvec() / 2).as_matrix()
    rotation["lowerarm02"] = half @ to_frame
    for number in (2, 3, 4, 5):
        ends = [*(head(f"finger{number}-{k}") for k in (1, 2, 3)), tail(f"finger{number}-3")]
        phalanges = [np.einsum("nij,nj->ni", to_frame, b - a) for a, b in pairwise(ends)]
        straight = phalanges[0].mean(0) * (1, 0, 1)  # the average fan of the fingers, in the plane of the palm
        for k, phalanx in enumerate(phalanges, start=1):
            rotation[f"finger{number}-{k}"] = _swing(phalanx, straight) @ to_frame

    position = {"wrist": np.zeros_like(head("wrist"))}
    for bone in BONES[3:]:
        finger, _, k = bone.removeprefix("finger").partition("-")
        parent = "wrist" if k in ("", "1") else f"finger{finger}-{int(k) - 1}"
        position[bone] = position[parent] + np.einsum("nij,nj->ni", rotation[parent], head(bone) - head(parent))
    for bone, child in (("lowerarm02", "wrist"), ("lowerarm01", "lowerarm02")):
        position[bone] = position[child] - np.einsum("nij,nj->ni", rotation[bone], head(child) - head(bone))

    vertices = np.zeros_like(hands.vertices)
    for bone, weight in zip(BONES, hands.weights.T, strict=True):
        moved = np.einsum("nij,nvj->nvi", rotation[bone], hands.vertices - head(bone)[:, None])
        vertices += weight[:, None] * (moved + position[bone][:, None])
    source = ["wrist", *(f"finger{_FINGER_NUMBERS[name[:-1]]}-{name[-1]}" for name in HAND_JOINTS[1:])]
    weights = hands.weights[:, [BONES.index(bone) for bone in source]]
    weights[:, 0] = 1 - weights[:, 1:].sum(1)
    return FlatHands(vertices, hands.faces, np.stack([position[bone] for bone in source], 1), weights)


def _hand_rotation(head, tail) -> np.ndarray:
    """(N, 3, 3) body frame → hand frame: middle finger's ray along −x, palm towards −y."""
    index, middle, pinky = (head(f"finger{k}-1") - head("wrist") for k in (2, 3, 5))
    palmar = np.cross(index, pinky)
    curl = tail("finger3-3") - head("finger3-1")
    palmar *= np.sign((curl * palmar).sum(-1).mean())  # relaxed fingers curl towards the palm
    distal = _unit(middle)
    palmar = _unit(palmar - (palmar * distal).sum(-1, keepdims=True) * distal)
    return np.stack([-distal, -palmar, np.cross(distal, palmar)], 1)


def _swing(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(N, 3) and (3,) directions → (N, 3, 3) shortest rotations from one to the other."""
    start, end = _unit(start), _unit(end)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, (start * end).sum(-1, keepdims=True))
    return Rotation.from_rotvec(axis / np.maximum(sine, 1e-12) * angle).as_matrix()


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
