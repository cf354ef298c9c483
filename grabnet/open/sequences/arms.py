"""Inverse kinematics of an arm: shoulder, elbow and wrist for a wrist that is to be somewhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from grabnet.open.sequences.motion import Pose

# Degrees, about what people can do: (lowest, highest) and where they like to be.
SUPINATION, WRIST_FLEXION, WRIST_DEVIATION = ((-15, 160), 70), ((-65, 65), 0), ((-32, 32), 0)
SWIVEL = ((-50, 85), 10)
LONGEST_REACH, SHORTEST_REACH = 0.985, 0.32  # shares of the arm's length
TWIST_OF_FOREARM = 0.6  # share of pronation that the forearm takes; the wrist has the rest, as skin does


class ArmPose(NamedTuple):
    """Rotations relative to the parent joints, (N, 3, 3) each, and what they ask of the arm, (N,) each.

    supination, flexion, deviation: degrees of the hand against the forearm. reach: share of the arm's length, above 1
    if the wrist is too far away (the arm is then stretched towards it). elbow: (N, 3) where it is.
    """

    shoulder: np.ndarray
    elbow: np.ndarray
    wrist: np.ndarray
    supination: np.ndarray
    flexion: np.ndarray
    deviation: np.ndarray
    reach: np.ndarray
    elbow_at: np.ndarray

    @property
    def rotations(self) -> np.ndarray:
        """(N, 3, 3, 3) of shoulder, elbow and wrist."""
        return np.stack([self.shoulder, self.elbow, self.wrist], 1)


class Arm:
    """One arm of a body in SMPL-X's rest pose.

    Args:
        joints: (55, 3) at rest. side: left or right.
    """

    def __init__(self, joints: np.ndarray, side: str):
        left = side == "left"
        self.side, self.outward = side, 1.0 if left else -1.0
        shoulder, elbow, wrist = (joints[j if left else j + 1] for j in (16, 18, 20))
        self.upper, self.fore = elbow - shoulder, wrist - elbow
        self.length = np.linalg.norm(self.upper), np.linalg.norm(self.fore)
        hinge = np.array([0, -self.outward, 0])
        self._upper_rest, self._fore_rest = _frame(self.upper, hinge), _frame(self.fore, hinge)

    def reach(self, chest: np.ndarray, shoulder: np.ndarray, wrist: Pose, swivel: np.ndarray) -> ArmPose:
        """The arm whose wrist joint is at `wrist`.

        Args:
            chest: (N, 3, 3) rotation of what the shoulder joint hangs on. shoulder: (N, 3) its position.
            wrist: N poses; at rest a hand's rotation is the unit matrix.
            swivel: (N,) degrees by which the elbow is turned about the line from shoulder to wrist, from hanging down
                (and somewhat outwards), positive outwards.
        """
        to_wrist = wrist.position - shoulder
        distance = np.linalg.norm(to_wrist, axis=-1)
        axis = to_wrist / distance[:, None]
        upper, fore = self.length
        far = distance / (upper + fore)
        bent = np.clip(distance, abs(upper - fore) + 1e-6, (upper + fore) * LONGEST_REACH)
        along = (upper**2 - fore**2 + bent**2) / (2 * bent)
        aside = np.sqrt(np.maximum(upper**2 - along**2, 0))
        hanging = np.broadcast_to([0.4 * self.outward, -1.0, -0.2], axis.shape)
        down = _unit(hanging - (hanging * axis).sum(-1, keepdims=True) * axis)
        turn = self.outward * np.radians(swivel)[:, None]
        bow = np.cos(turn) * down + np.sin(turn) * np.cross(axis, down)
        elbow = shoulder + along[:, None] * axis + aside[:, None] * bow
        end = shoulder + bent[:, None] * axis
        hinge = np.cross(elbow - shoulder, end - elbow)
        upper_world = _frame(elbow - shoulder, hinge) @ self._upper_rest.T
        fore_world = _frame(end - elbow, hinge) @ self._fore_rest.T

        against = np.swapaxes(fore_world, -1, -2) @ wrist.rotation
        bone = _unit(self.fore)
        quaternion = Rotation.from_matrix(against).as_quat()
        twist = 2 * np.arctan2(quaternion[:, :3] @ bone, quaternion[:, 3])
        sign = -self.outward
        likely = np.radians(SUPINATION[1])  # the turn is counted within half a circle of it
        twist = sign * ((sign * twist - likely + np.pi) % (2 * np.pi) - np.pi + likely)
        twisted = Rotation.from_rotvec(twist[:, None] * bone)
        bend = (Rotation.from_matrix(against) * twisted.inv()).as_rotvec()
        part = Rotation.from_rotvec(TWIST_OF_FOREARM * twist[:, None] * bone).as_matrix()
        return ArmPose(
            np.swapaxes(chest, -1, -2) @ upper_world,
            np.swapaxes(upper_world, -1, -2) @ fore_world @ part,
            np.swapaxes(part, -1, -2) @ against,
            np.degrees(sign * twist),
            np.degrees(_about_thumb(bend, twisted)),
            np.degrees(_about_palm(bend, twisted)),
            far,
            elbow,
        )


def effort(pose: ArmPose, swivel: np.ndarray) -> np.ndarray:
    """(N,) how uneasy arm poses are: about 0 at ease, 1 near the limits of one joint, infinite beyond a limit."""
    total = np.zeros(len(swivel))
    beyond = (pose.reach > LONGEST_REACH) | (pose.reach < SHORTEST_REACH)
    for value, ((low, high), middle) in (
        (pose.supination, SUPINATION), (pose.flexion, WRIST_FLEXION), (pose.deviation, WRIST_DEVIATION),
        (swivel, SWIVEL),
    ):  # fmt: skip
        beyond |= (value < low) | (value > high)
        total += ((value - middle) / np.where(value > middle, high - middle, middle - low)) ** 2
    total += np.maximum(pose.reach - 0.9, 0) ** 2 * 100
    return np.where(beyond, np.inf, total)


def strained(pose: ArmPose, margin: float = 18) -> np.ndarray:
    """(N,) whether a wrist is more than `margin` degrees beyond its limits, as may not even be passed through."""
    limits = ((pose.supination, SUPINATION), (pose.flexion, WRIST_FLEXION), (pose.deviation, WRIST_DEVIATION))
    return np.any([(v < low - margin) | (v > high + margin) for v, ((low, high), _) in limits], axis=0)


def _about_thumb(bend: np.ndarray, twisted: Rotation) -> np.ndarray:
    """Flexion: the part of a bend about the hand's thumb side (z), in radians."""
    return (bend * twisted.apply([0.0, 0, 1])).sum(-1)


def _about_palm(bend: np.ndarray, twisted: Rotation) -> np.ndarray:
    """Deviation: the part of a bend about the palm's normal (y), in radians."""
    return (bend * twisted.apply([0.0, 1, 0])).sum(-1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _frame(along: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """(..., 3, 3) columns: along, beside made perpendicular to it, and their cross product."""
    along = _unit(along)
    beside = _unit(beside - (beside * along).sum(-1, keepdims=True) * along)
    return np.stack([along, beside, np.cross(along, beside)], -1)
