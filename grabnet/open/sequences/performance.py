"""A recording while it is being made: what every part does, move after move."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from grabnet.open.sequences.actor import SIDES, UPRIGHT, Actor
from grabnet.open.sequences.arms import LONGEST_REACH, strained
from grabnet.open.sequences.motion import Pose, between, minimum_jerk, ramp

FRAMERATE = 120
FLAT = np.zeros(21)


class InfeasibleError(Exception):
    """This plan can't be carried out; another draw may. Its text is the reason, to be counted."""


@dataclass(frozen=True)
class Guided:
    """An arm whose wrist goes along `wrist` (N poses) while its elbow turns to `swivel` degrees."""

    wrist: Pose
    swivel: float


@dataclass
class Performance:
    """Frames so far.

    Attributes:
        thing: pose of the object.
        trunk (T, 5); arms[side] (T, 3, 3, 3) rotations of shoulder, elbow, wrist; fingers[side] (T, 21); things: the
        object's poses: each a list of one chunk a move.
        held: (T,) names of the hands that hold the object, "" for none.
    """

    actor: Actor
    thing: Pose
    trunk: list[np.ndarray] = field(default_factory=list)
    arms: dict[str, list[np.ndarray]] = field(default_factory=lambda: {side: [] for side in SIDES})
    fingers: dict[str, list[np.ndarray]] = field(default_factory=lambda: {side: [] for side in SIDES})
    things: list[Pose] = field(default_factory=list)
    held: list[str] = field(default_factory=list)

    def __post_init__(self):
        self._trunk = UPRIGHT
        self._arms = {side: np.tile(np.eye(3), (3, 1, 1)) for side in SIDES}
        self._fingers = dict.fromkeys(SIDES, FLAT)
        self._swivel = dict.fromkeys(SIDES, 0.0)

    def move(
        self,
        seconds: float,
        trunk: np.ndarray | None = None,
        right: Guided | np.ndarray | None = None,
        left: Guided | np.ndarray | None = None,
        fingers: dict[str, np.ndarray] | None = None,
        thing: Pose | None = None,
        held: str = "",
    ) -> None:
        """Go on for some seconds.

        Args:
            trunk: (5,) where the trunk goes. right, left: `Guided`, or (3, 3, 3) rotations that the arm goes to in its
                own joints; what is omitted stays, relative to the body.
            fingers: (21,) angles that the hands go to, by side.
            thing: N poses of the object, or stays.

        Raises:
            InfeasibleError: a wrist is out of reach.
        """
        n = round(seconds * FRAMERATE)
        trunks = ramp(self._trunk, self._trunk if trunk is None else trunk, n)
        for side, goal in (("right", right), ("left", left)):
            if isinstance(goal, Guided):
                swivel = ramp(np.array([self._swivel[side]]), np.array([goal.swivel]), n)[:, 0]
                pose = self.actor.reach(side, self.actor.trunk(trunks), goal.wrist, swivel)
                if (pose.reach > LONGEST_REACH).any():
                    raise InfeasibleError("out of reach on the way")
                if strained(pose).any():
                    raise InfeasibleError("wrist beyond its limits on the way")
                rotations = pose.rotations
                self._swivel[side] = goal.swivel
            else:
                end = self._arms[side] if goal is None else goal
                rotations = between(self._arms[side], end, minimum_jerk(np.arange(1, n + 1) / n))
            self.arms[side].append(rotations)
            self._arms[side] = rotations[-1]
            goal_fingers = (fingers or {}).get(side, self._fingers[side])
            self.fingers[side].append(ramp(self._fingers[side], goal_fingers, n))
            self._fingers[side] = goal_fingers
        things = thing or Pose(np.tile(self.thing.rotation, (n, 1, 1)), np.tile(self.thing.position, (n, 1)))
        self.things.append(things)
        self.thing = Pose(things.rotation[-1], things.position[-1])
        self.trunk.append(trunks)
        self._trunk = trunks[-1]
        self.held += [held] * n

    def at(self, side: str, wrist: Pose, swivel: float, trunk: np.ndarray) -> np.ndarray:
        """(3, 3, 3) rotations of an arm whose wrist is at one pose; its elbow is then known to be at `swivel`."""
        self._swivel[side] = swivel
        one = Pose(wrist.rotation[None], wrist.position[None])
        return self.actor.reach(side, self.actor.trunk(trunk[None]), one, np.array([swivel])).rotations[0]

    def swivel(self, side: str) -> float:
        """Where a guided arm's elbow is now, degrees."""
        return self._swivel[side]

    def resting(self, seconds: float) -> Pose:
        """The object's present pose, for so many seconds."""
        n = round(seconds * FRAMERATE)
        return Pose(np.tile(self.thing.rotation, (n, 1, 1)), np.tile(self.thing.position, (n, 1)))


def sway(path: Pose, turn: np.ndarray, shift: np.ndarray, cycles: float) -> Pose:
    """To and fro about N equal poses, by rotation vector `turn` and `shift` metres at most, from rest to rest."""
    n = len(path.position)
    share = np.arange(1, n + 1) / n
    amount = minimum_jerk(3 * share) * minimum_jerk(3 * (1 - share)) * np.sin(2 * np.pi * cycles * share)
    turned = Rotation.from_rotvec(amount[:, None] * turn).as_matrix()
    return Pose(turned @ path.rotation, path.position + amount[:, None] * shift)
