"""A subject as a figure to be moved: trunk, arms and hands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel, HandParameters
from grabnet.body.skeleton import JOINTS
from grabnet.body.whole import BodyModel
from grabnet.geometry.rotations import matrix_to_axis_angle
from grabnet.open.body.subjects import Subject
from grabnet.open.sequences.arms import Arm, ArmPose
from grabnet.open.sequences.motion import Pose

SIDES = ("right", "left")
# What the trunk does, radians: bending forward, turning and leaning to the left, looking down and to the left.
LEAN, TURN, TILT, DOWN, ASIDE = range(5)
UPRIGHT = np.zeros(5)
_OF_PELVIS = 0.35  # share of the lean that the pelvis takes, about the hips, so that legs and feet stay where they are
_AXIAL = np.array([1, -1, -1], np.float32)
# An arm that has nothing to do hangs beside the body and somewhat behind it, clear of the table: radians by which the
# shoulder drops and goes back and the elbow bends.
_DROP, _BACK, _BEND = 1.15, 0.3, 0.3
# One that waits for its turn in a hand-over has its hand above the table already, before its own shoulder.
_READY_DROP, _READY_BEND = 0.55, 1.9


@dataclass(frozen=True)
class Trunk:
    """Of N frames: rotations (N, 3, 3) by joint name, relative to the parents; transl (N, 3) of the body.

    chest: where the body's uppermost spine joint is. head: where the head joint is. Poses of N frames.
    """

    rotations: dict[str, np.ndarray]
    transl: np.ndarray
    chest: Pose
    head: Pose


class Actor:
    """Moves one subject.

    Attributes:
        arms: by side. floor: height of the soles, metres, the pelvis at rest being at 0.
        girth: half width (x) and half depth (z) of the waist, and how far its middle is before the spine, metres.
    """

    def __init__(self, subject: Subject, body: BodyModel, hand: HandModel):
        self.subject, self.body, self.hand, self.anatomy = subject, body, hand, Anatomy.of(hand)
        self.v_template = torch.as_tensor(subject.v_template)
        self.joints = body.rest_joints(self.v_template).double().numpy()
        self.arms = {side: Arm(self.joints, side) for side in SIDES}
        self.floor = float(subject.v_template[:, 1].min())
        self.rest_hand = {"right": torch.as_tensor(subject.rhand), "left": torch.as_tensor(subject.lhand)}
        self.girth = self._girth()
        self.hand_wrist = hand.rest_joints(self.rest_hand["right"])[0].double().numpy()

    def trunk(self, values: np.ndarray) -> Trunk:
        """Pose the trunk by (N, 5) values."""
        lean, turn, tilt, down, aside = values.T
        zero = np.zeros_like(lean)
        pelvis = _turned(_OF_PELVIS * lean, zero, zero)
        spine = _turned((1 - _OF_PELVIS) * lean / 3, turn / 3, tilt / 3)
        look = _turned(down / 2, aside / 2, zero)
        still = np.swapaxes(pelvis, -1, -2)
        rotations = {"pelvis": pelvis, "left_hip": still, "right_hip": still}
        rotations |= dict.fromkeys(("spine1", "spine2", "spine3"), spine) | dict.fromkeys(("neck", "head"), look)
        hips = (self._rest("left_hip") + self._rest("right_hip")) / 2
        at = Pose(pelvis, hips + (pelvis @ (self._rest("pelvis") - hips)))
        transl = at.position - self._rest("pelvis")
        for above, joint in (("pelvis", "spine1"), ("spine1", "spine2"), ("spine2", "spine3")):
            at = at @ Pose(spine, self._rest(joint) - self._rest(above))
        head = at
        for above, joint in (("spine3", "neck"), ("neck", "head")):
            head = head @ Pose(look, self._rest(joint) - self._rest(above))
        return Trunk(rotations, transl, at, head)

    def shoulder(self, trunk: Trunk, side: str) -> np.ndarray:
        """(N, 3) positions of a shoulder joint."""
        return trunk.chest.points((self._rest(f"{side}_shoulder") - self._rest("spine3"))[None])[:, 0]

    def reach(self, side: str, trunk: Trunk, wrist: Pose, swivel: np.ndarray) -> ArmPose:
        """The arm whose wrist joint is at N poses, its elbow turned to (N,) swivels, degrees."""
        return self.arms[side].reach(trunk.chest.rotation, self.shoulder(trunk, side), wrist, swivel)

    def off_trunk(self, trunk: Trunk, points: np.ndarray) -> np.ndarray:
        """(N, P) metres, about, from points (N, P, 3) to the trunk, as if it were a column; far above the shoulders."""
        wide, deep, middle = self.girth
        local = trunk.chest.inverse().points(points)
        out = (np.hypot(local[..., 0] / wide, (local[..., 2] - middle) / deep) - 1) * min(wide, deep)
        return np.where(local[..., 1] > self._rest("neck")[1] - self._rest("spine3")[1], np.inf, out)

    def hanging(self, side: str) -> np.ndarray:
        """(3, 3, 3) rotations of an arm that has nothing to do."""
        return _arm(side, _BACK, _DROP, _BEND)

    def ready(self, side: str) -> np.ndarray:
        """(3, 3, 3) rotations of an arm that waits for its turn, its hand above any table."""
        return _arm(side, 0, _READY_DROP, _READY_BEND)

    def hand_vertices(self, side: str, wrist: Pose, angles: np.ndarray) -> np.ndarray:
        """(N, 778, 3) of hands whose wrist joints are at N poses, with (N, 21) anatomical angles."""
        pose = HandParameters(
            torch.eye(3).expand(len(angles), 3, 3), self.anatomy.hand_pose(_tensor(angles)), torch.zeros(len(angles), 3)
        )
        vertices = self.hand(pose, self.rest_hand["right"]).vertices.double().numpy() - self.hand_wrist
        return wrist.points(vertices * (1 if side == "right" else (-1, 1, 1)))

    def finger_pose(self, side: str, angles: np.ndarray) -> np.ndarray:
        """(N, 45) axis-angle of (N, 21) anatomical angles."""
        pose = matrix_to_axis_angle(self.anatomy.hand_pose(_tensor(angles))).numpy()
        return (pose * (1 if side == "right" else _AXIAL)).reshape(len(angles), 45)

    def _girth(self) -> tuple[float, float, float]:
        part = self.body.weights.argmax(1).numpy()
        of_trunk = np.isin(part, [JOINTS.index(j) for j in ("spine1", "spine2", "spine3")])
        vertices = self.subject.v_template[of_trunk] - self._rest("spine3")
        waist = vertices[vertices[:, 1] < 0]
        (wide, _, high), (_, _, low) = waist.max(0), waist.min(0)
        return float(wide), float(high - low) / 2, float(high + low) / 2

    def _rest(self, joint: str) -> np.ndarray:
        return self.joints[JOINTS.index(joint)]


def _arm(side: str, back: float, drop: float, bend: float) -> np.ndarray:
    """(3, 3, 3) rotations of an arm lowered beside the body from T-pose, the elbow bent forward."""
    inward = 1 if side == "right" else -1
    shoulder = Rotation.from_rotvec([back, 0, 0]) * Rotation.from_rotvec([0, 0, inward * drop])
    elbow = Rotation.from_rotvec([0, inward * bend, 0])
    return np.stack([shoulder.as_matrix(), elbow.as_matrix(), np.eye(3)])


def _turned(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(np.stack([x, y, z], -1)).as_matrix()


def _tensor(array: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(np.asarray(array, np.float32))
