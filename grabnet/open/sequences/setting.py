"""The table, and drawing where the object lies and how it is reached, carried and handed over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from grabnet.open.sequences.actor import ASIDE, DOWN, LEAN, TILT, TURN, Actor
from grabnet.open.sequences.arms import effort
from grabnet.open.sequences.motion import Pose
from grabnet.open.sequences.performance import InfeasibleError
from grabnet.open.sequences.props import UP, Hold, Holds, StageProp

TABLE_HEIGHTS = (0.75, 1.20)  # metres above the floor
TABLE_SIZE = (1.10, 0.03, 0.70)  # metres: width, thickness, depth
TABLE_EDGE = 0.27  # metres from the pelvis at rest to the near edge
_FOREARM_RADIUS = 0.045  # metres that the bones of the forearm stay above the table
_SOFT = 0.02  # metres that they may be nearer to the trunk: it is no column, and gives way


@dataclass(frozen=True)
class Table:
    """A table top: its height above the pelvis at rest, and the middle of its upper side (x, y, z)."""

    top: float

    @property
    def centre(self) -> np.ndarray:
        return np.array([0.0, self.top, TABLE_EDGE + TABLE_SIZE[2] / 2])


class Reach(NamedTuple):
    """A way to have the object somewhere: its pose, and per hand that holds it the elbow's swivel; the trunk (5,)."""

    thing: Pose
    trunk: np.ndarray
    swivels: tuple[float, ...]


class Draws(NamedTuple):
    """N random trunks (N, 5) and swivels (N, hands) of the elbows."""

    trunk: np.ndarray
    swivel: np.ndarray


def draw_trunks(rng: np.random.Generator, n: int, hands: int, lean: tuple[float, float] = (-0.03, 0.75)) -> Draws:
    """Random trunks and swivels."""
    trunk = np.zeros((n, 5))
    trunk[:, LEAN] = rng.uniform(*lean, n)
    trunk[:, TURN], trunk[:, TILT] = rng.uniform(-0.5, 0.5, n), rng.uniform(-0.15, 0.15, n)
    return Draws(trunk, rng.uniform(-35, 70, (n, hands)))


def look_at(actor: Actor, trunk: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The trunk (5,) with its gaze turned towards a point (3,)."""
    way = target - (actor.trunk(trunk[None]).head.position[0] + [0, 0.08, 0.05])
    looking = trunk.copy()
    looking[DOWN] = np.clip(np.arctan2(-way[1], np.hypot(way[0], way[2])) - trunk[LEAN], -0.3, 0.75)
    looking[ASIDE] = np.clip(np.arctan2(way[0], way[2]) - trunk[TURN], -0.6, 0.6)
    return looking


def trunk_effort(trunk: np.ndarray) -> np.ndarray:
    """(N,) how far trunks (N, 5) are from upright."""
    return 1.2 * trunk[:, LEAN] ** 2 + 1.5 * trunk[:, TURN] ** 2 + 8 * trunk[:, TILT] ** 2


def hand_effort(
    actor: Actor, side: str, wrist: Pose, draws: Draws, column: int, table: Table | None, back: np.ndarray | None
) -> np.ndarray:
    """(N,) effort of reaching N wrists; infinite where the forearm would go through the table or the trunk.

    Args:
        back: (3,) or (N, 3) offset in the world of the wrist before it comes, which must be in reach too.
    """
    trunk, swivel = actor.trunk(draws.trunk), draws.swivel[:, column]
    pose = actor.reach(side, trunk, wrist, swivel)
    total = effort(pose, swivel)
    if back is not None:
        before = Pose(wrist.rotation, wrist.position + back)
        total += 0.3 * effort(actor.reach(side, trunk, before, swivel), swivel)
    share = np.linspace(0.12, 1, 5)[:, None]
    forearm = wrist.position[:, None] + share * (pose.elbow_at - wrist.position)[:, None]
    blocked = actor.off_trunk(trunk, forearm) < _FOREARM_RADIUS - _SOFT
    if table is not None:
        over = forearm[..., 2] > TABLE_EDGE - _FOREARM_RADIUS
        blocked |= over & (forearm[..., 1] < table.top + _FOREARM_RADIUS)
    return np.where(blocked.any(1), np.inf, total)


def place(
    actor: Actor,
    holds: Holds,
    side: str,
    table: Table,
    rest: np.ndarray,
    rng: np.random.Generator,
    also: Hold | None = None,
    only: np.ndarray | None = None,
    n: int = 5000,
    tries: int = 12,
) -> tuple[Hold, Reach]:
    """Where the object lies, turned by `rest`, and how the `side` hand takes it there.

    Args:
        also: a hold by which the object is put there first, which must be easy too.
        only: numbers of the grasps to choose from; all when omitted.

    Raises:
        InfeasibleError: no easy grasp found.
    """
    prop = holds.prop
    free = holds.clears(side, rest).nonzero()[0]
    free = free if only is None else np.intersect1d(free, only)
    if not len(free):
        raise InfeasibleError("no grasp clears the table")
    draws = draw_trunks(rng, n, 2)
    grasp = rng.choice(free, n)
    wrist = Pose(holds.wrist[side].rotation[grasp], holds.wrist[side].position[grasp])
    # The forearm points from the hand to somewhere beside the body: headings are drawn about that.
    inward = UP @ rest
    forearm = (inward @ wrist.rotation[:, :, 0, None])[..., 0] * (1 if side == "right" else -1)
    outward = actor.arms[side].outward
    wanted = rng.normal(0.35 * outward, 0.5, n)  # heading of the elbow as seen from the hand, from straight back
    heading = np.arctan2(np.sin(wanted), -np.cos(wanted)) - np.arctan2(forearm[:, 0], forearm[:, 2])
    rotation = Rotation.from_rotvec(np.stack([0 * heading, heading, 0 * heading], 1)).as_matrix() @ inward
    radius = np.linalg.norm((prop.vertices @ rest.T)[:, :2] - (prop.vertices @ rest.T)[:, :2].mean(0), axis=1).max()
    middle = prop.vertices.mean(0)
    at = np.stack(
        [rng.uniform(-0.12, 0.38, n) * outward, np.zeros(n), TABLE_EDGE + radius + rng.uniform(0.02, 0.25, n)], 1
    )
    at -= (rotation @ middle) * [1, 0, 1]
    at[:, 1] = table.top - (prop.vertices @ rest[2]).min()
    thing = Pose(rotation, at)
    total = trunk_effort(draws.trunk)
    total = total + hand_effort(actor, side, thing @ wrist, draws, 0, table, np.array([0, 0.05, -0.05]))
    if also:
        total = total + hand_effort(actor, also.side, thing @ also.wrist, draws, 1, table, thing_offset(thing, also))
    total = total + 0.25 * rng.gumbel(size=n)
    tried: set[int] = set()
    for i in np.argsort(total):
        if np.isinf(total[i]) or len(tried) >= tries:
            break
        if int(grasp[i]) in tried:
            continue
        tried.add(int(grasp[i]))
        here = Pose(thing.rotation[i], thing.position[i])
        hold = holds.hold(side, int(grasp[i]), rest[2], float((prop.vertices @ rest[2]).min()))
        if hold is None:
            continue
        before = hold.approach(here)
        one = Draws(draws.trunk[i : i + 1], draws.swivel[i : i + 1])
        lone = Pose(before.rotation[None], before.position[None])
        if np.isinf(hand_effort(actor, side, lone, one, 0, table, None)[0]):
            continue
        swivels = tuple(float(x) for x in draws.swivel[i])
        return hold, Reach(here, look_at(actor, draws.trunk[i], here.points(middle[None])[0]), swivels)
    raise InfeasibleError("no easy grasp on the table")


def thing_offset(thing: Pose, hold: Hold) -> np.ndarray:
    """(N, 3) in the world of a hold's approach, the object being at N poses."""
    return thing.rotation @ hold.back


def carry(
    actor: Actor,
    hold: Hold,
    prop: StageProp,
    things: Pose,
    rng: np.random.Generator,
    table: Table | None = None,
    lean: tuple[float, float] = (-0.05, 0.25),
    accept=None,
) -> Reach:
    """The easiest of N poses of the held object.

    Args:
        things: the N poses to choose from.
        accept: `accept(pose, trunk) → pose or None`, a last say on a choice, called a few times.

    Raises:
        InfeasibleError: none is in reach.
    """
    n = len(things.position)
    draws = draw_trunks(rng, n, 1, lean)
    total = trunk_effort(draws.trunk) + hand_effort(actor, hold.side, things @ hold.wrist, draws, 0, table, None)
    total += 0.2 * rng.gumbel(size=n)
    for i in np.argsort(total)[:12]:
        if np.isinf(total[i]):
            break
        thing = Pose(things.rotation[i], things.position[i])
        trunk, swivel = draws.trunk[i], draws.swivel[i]
        if accept:
            found = accept(thing, trunk)
            if found is None:
                continue
            thing = found
            wrist = thing @ hold.wrist
            lone = Pose(wrist.rotation[None], wrist.position[None])
            if np.isinf(hand_effort(actor, hold.side, lone, Draws(trunk[None], swivel[None]), 0, None, None)[0]):
                continue
        else:
            trunk = look_at(actor, trunk, thing.points(prop.vertices.mean(0)[None])[0])
        return Reach(thing, trunk, (float(swivel[0]),))
    raise InfeasibleError("nowhere to carry it")


def somewhere(
    rng: np.random.Generator,
    prop: StageProp,
    from_rotation: np.ndarray,
    low: tuple,
    high: tuple,
    tilt: float,
    turn: float,
    n: int = 3000,
) -> Pose:
    """N random poses: centroids in a box, turned about the vertical and tilted from `from_rotation` (radians)."""
    vectors = rng.normal(0, 1, (n, 3)) * [tilt, turn, tilt]
    rotation = Rotation.from_rotvec(vectors).as_matrix() @ from_rotation
    return Pose(rotation, rng.uniform(low, high, (n, 3)) - rotation @ prop.vertices.mean(0))
