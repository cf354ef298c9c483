"""Anatomical places on any body in SMPL-X's schema, found from its joints and skin.

A place is where a ray leaves the skin: it starts on the line between two joints and points in a direction of the
resting body. x points to the body's left, y up and z ahead; arms are spread, palms down.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np
import torch

from grabnet.body.skeleton import JOINTS, MODEL_FINGERS
from grabnet.body.whole import BodyModel
from grabnet.errors import UserError

_FRONT, _BACK, _UP, _DOWN, _LEFT = (0, 0, 1), (0, 0, -1), (0, 1, 0), (0, -1, 0), (1, 0, 0)
_THUMB_NAIL = (0.0, 0.75, 0.66)


@dataclass(frozen=True)
class Place:
    """Where on the skin.

    Attributes:
        start, end: joints; of a finger's last phalanx the end is its tip.
        along: share of the way from start to end.
        direction: of the ray.
        parts: joints one of which moves the skin there more than any other joint does.
        shift: of the ray's start, in distances between the eyes, for places of head and face.
    """

    start: str
    end: str
    along: float
    direction: tuple[float, float, float]
    parts: tuple[str, ...]
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def mirrored(self) -> Place:
        """The same on the other side."""
        x, y, z = self.direction
        sx, sy, sz = self.shift
        return Place(
            _other(self.start), _other(self.end), self.along, (-x, y, z), tuple(map(_other, self.parts)), (-sx, sy, sz)
        )


def _other(name: str) -> str:
    return name.replace("left_", "right_") if name.startswith("left_") else name.replace("right_", "left_")


_TRUNK = ("pelvis", "spine1", "spine2", "spine3", "neck", "left_collar", "right_collar")
_HEAD, _JAW, _FACE = ("head",), ("jaw",), ("head", "jaw")
_SHOULDER = ("left_shoulder", "left_collar", "spine3")
_HIPS = ("pelvis", "left_hip", "right_hip", "spine1")

_MIDDLE = {
    "top_of_head": Place("head", "head", 0, _UP, _HEAD, (0, 1.0, -0.4)),
    "nape": Place("neck", "neck", 0, _BACK, _TRUNK),
    "upper_back": Place("spine2", "spine3", 0.3, _BACK, _TRUNK),
    "tenth_thoracic_vertebra": Place("spine3", "neck", 0.36, _BACK, _TRUNK),
    "jugular_notch": Place("spine3", "neck", 0.75, _FRONT, _TRUNK),
    "xiphoid_process": Place("spine3", "neck", 0.2, _FRONT, _TRUNK),
    "hollow_of_throat": Place("spine3", "neck", 0.6, _FRONT, _TRUNK),
    "breastbone": Place("spine2", "spine3", 0.6, _FRONT, _TRUNK),
    "lower_back": Place("spine1", "spine1", 0, _BACK, _TRUNK),
    "nose_tip": Place("left_eye", "right_eye", 0.5, _FRONT, _HEAD, (0, -0.75, 0)),
    "upper_lip": Place("left_eye", "right_eye", 0.5, _FRONT, _HEAD, (0, -1.12, 0)),
    "lower_lip": Place("left_eye", "right_eye", 0.5, _FRONT, _JAW, (0, -1.45, 0)),
    "chin": Place("left_eye", "right_eye", 0.5, _FRONT, _JAW, (0, -1.85, 0)),
}  # fmt: skip
_LEFT_SIDE = {
    "temple": Place("head", "head", 0, (0.75, 0, 0.65), _HEAD, (0, 1.7, 0.2)),
    "back_of_head": Place("head", "head", 0, (0.6, 0, -0.8), _HEAD, (0, 1.5, -0.2)),
    "side_of_brow": Place("head", "head", 0, (1, 0, 0.4), _HEAD, (0, 1.1, 0.2)),
    "side_of_back_of_head": Place("head", "head", 0, (0.75, 0, -0.65), _HEAD, (0, 1.1, -0.2)),
    "middle_of_scapula": Place("spine3", "left_shoulder", 0.8, (-0.5, 0, -1), (*_SHOULDER, *_TRUNK)),
    "shoulder_blade": Place("spine3", "left_shoulder", 0.5, (0, -0.25, -1), (*_SHOULDER, *_TRUNK)),
    "collar_bone": Place("left_collar", "left_shoulder", 0.3, (0, 0.4, 1), (*_SHOULDER, *_TRUNK)),
    "shoulder_tip": Place("left_collar", "left_shoulder", 0.95, _UP, _SHOULDER),
    "shoulder_front": Place("left_shoulder", "left_elbow", 0.12, (0, 0.1, 1), _SHOULDER),
    "upper_arm_back": Place("left_shoulder", "left_elbow", 0.55, (0, 0.2, -1), ("left_shoulder",)),
    "upper_arm_front": Place("left_shoulder", "left_elbow", 0.65, (0, 0.6, 1), ("left_shoulder",)),
    "elbow_outer": Place("left_shoulder", "left_elbow", 1.0, (0, 1, -0.35), ("left_shoulder", "left_elbow")),
    "elbow_inner": Place("left_shoulder", "left_elbow", 1.0, (0, -1, -0.1), ("left_shoulder", "left_elbow")),
    "forearm": Place("left_elbow", "left_wrist", 0.5, (0, 1, -0.3), ("left_elbow",)),
    "wrist_thumb_side": Place("left_elbow", "left_wrist", 0.93, _FRONT, ("left_elbow", "left_wrist")),
    "wrist_little_finger_side": Place("left_elbow", "left_wrist", 0.93, _BACK, ("left_elbow", "left_wrist")),
    "hip_front": Place("left_hip", "spine1", 0.45, (0.75, 0, 1), _HIPS),
    "hip_back": Place("left_hip", "spine1", 0.55, (0.1, 0, -1), _HIPS),
    "waist": Place("left_hip", "spine1", 0.6, (1, 0, 0.1), _HIPS),
    "thigh_outer": Place("left_hip", "left_knee", 0.55, (1, 0, 0.15), ("left_hip",)),
    "thigh_front": Place("left_hip", "left_knee", 0.65, (0.1, 0, 1), ("left_hip",)),
    "knee_outer": Place("left_hip", "left_knee", 1.0, _LEFT, ("left_hip", "left_knee")),
    "knee_inner": Place("left_hip", "left_knee", 1.0, (-1, 0, 0), ("left_hip", "left_knee")),
    "shin": Place("left_knee", "left_ankle", 0.5, (0.45, 0, 1), ("left_knee",)),
    "ankle_outer": Place("left_knee", "left_ankle", 0.98, _LEFT, ("left_knee", "left_ankle")),
    "ankle_inner": Place("left_knee", "left_ankle", 0.98, (-1, 0, 0), ("left_knee", "left_ankle")),
    "heel": Place("left_ankle", "left_foot", 0.0, (0, -0.45, -1), ("left_ankle",)),
    "second_metatarsal": Place("left_ankle", "left_foot", 1.0, _UP, ("left_foot", "left_ankle")),
    "toes": Place("left_ankle", "left_foot", 1.15, _UP, ("left_foot",)),
    "ball_of_foot_outer": Place("left_ankle", "left_foot", 0.95, (1, -0.1, 0), ("left_foot", "left_ankle")),
    "inner_brow": Place("left_eye", "left_eye", 0, _FRONT, _HEAD, (-0.22, 0.42, 0)),
    "outer_brow": Place("left_eye", "left_eye", 0, (0.35, 0, 1), _HEAD, (0.3, 0.38, 0)),
    "cheek": Place("left_eye", "left_eye", 0, (0.3, 0, 1), _FACE, (0.12, -0.7, 0)),
    "mouth_corner": Place("left_eye", "right_eye", 0.5, _FRONT, _FACE, (0.4, -1.28, 0)),
    "jaw": Place("left_eye", "right_eye", 0.5, (1, 0, 0.35), _JAW, (0.3, -1.6, -0.3)),
    "back_of_hand_index": Place("left_wrist", "left_index1", 0.65, _UP, ("left_wrist",)),
    "second_metacarpal": Place("left_wrist", "left_index1", 0.9, _UP, ("left_wrist", "left_index1")),
    "back_of_hand_pinky": Place("left_wrist", "left_pinky1", 0.65, _UP, ("left_wrist",)),
    "back_of_hand_wrist": Place("left_wrist", "left_middle1", 0.25, _UP, ("left_wrist",)),
    **{
        f"{finger}{k}": Place(
            f"left_{finger}{k}", f"left_{finger}{k + 1}" if k < 3 else f"left_{finger}_tip", 0.5 if k < 3 else 0.6,
            _THUMB_NAIL if finger == "thumb" else _UP, (f"left_{finger}{k}",),
        )
        for finger in MODEL_FINGERS for k in (1, 2, 3)
    },
}  # fmt: skip
PLACES = {
    **_MIDDLE,
    **{f"left_{name}": place for name, place in _LEFT_SIDE.items()},
    **{f"right_{name}": place.mirrored() for name, place in _LEFT_SIDE.items()},
}


class Skin:
    """The skin of a resting body, which is asked for places.

    Args:
        body: in SMPL-X's schema.
        v_template: (V, 3) of a subject; the model's own when omitted.
    """

    def __init__(self, body: BodyModel, v_template: torch.Tensor | None = None):
        rest = body.v_template if v_template is None else v_template
        self.vertices = rest.double().numpy()
        self._owner = body.weights.argmax(1).numpy()
        joints = dict(zip(JOINTS, body.rest_joints(rest).double().numpy(), strict=True))
        for side in ("left", "right"):
            for finger in MODEL_FINGERS:
                joints[f"{side}_{finger}_tip"] = self._tip(joints, f"{side}_{finger}")
        self._joints = joints
        self._between_eyes = float(np.linalg.norm(joints["left_eye"] - joints["right_eye"]))

    def vertex(self, name: str) -> int:
        """The vertex at a place.

        Raises:
            UserError: no such place.
        """
        if name not in PLACES:
            close = difflib.get_close_matches(name, PLACES, n=1)
            nearest = f"its nearest is '{close[0]}'; " if close else ""
            raise UserError(f"There is no place '{name}'; {nearest}the places are {', '.join(PLACES)}.")
        place = PLACES[name]
        start, end = self._joints[place.start], self._joints[place.end]
        origin = start + place.along * (end - start) + self._between_eyes * np.array(place.shift)
        direction = np.array(place.direction) / np.linalg.norm(place.direction)
        candidates = np.isin(self._owner, [JOINTS.index(part) for part in place.parts]).nonzero()[0]
        offset = self.vertices[candidates] - origin
        ahead = offset @ direction
        aside = np.linalg.norm(offset - ahead[:, None] * direction, axis=1)
        aside[ahead < 0] = np.inf
        # Where the ray leaves for good: the farthest of the vertices about as close to it as the closest.
        close = aside <= aside.min() + 0.2 * self._between_eyes * (0.25 if place.parts[0][-1].isdigit() else 1)
        return int(candidates[close][(ahead - aside)[close].argmax()])

    def _tip(self, joints: dict[str, np.ndarray], finger: str) -> np.ndarray:
        """The end of the last phalanx."""
        joint = joints[f"{finger}3"]
        along = joint - joints[f"{finger}2"]
        skin = self.vertices[self._owner == JOINTS.index(f"{finger}3")] - joint
        reach = (skin @ along).max() / (along @ along)
        return joint + reach * along
