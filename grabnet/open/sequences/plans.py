"""The four intents of GRAB as plans: lift, pass, use, and off-hand pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from grabnet.open.sequences.actor import UPRIGHT, Actor
from grabnet.open.sequences.face import Face
from grabnet.open.sequences.motion import Pose, travel
from grabnet.open.sequences.performance import FLAT, FRAMERATE, Guided, InfeasibleError, Performance, sway
from grabnet.open.sequences.props import UP, Hold, Holds, StageProp
from grabnet.open.sequences.setting import (
    Draws,
    Reach,
    Table,
    carry,
    draw_trunks,
    hand_effort,
    look_at,
    place,
    somewhere,
    thing_offset,
    trunk_effort,
)
from grabnet.open.sequences.uses import motion_of, tilt_of, use_of

_T_POSE = np.tile(np.eye(3), (3, 1, 1))
# Metres between the two hands' vertices when both hold the object; a coarser measure of it, to choose by.
_HANDS_APART, _ROOM = 0.004, 0.012
# Where a hand is between its own side and where its approach starts: above the table, metres.
_ABOVE = np.array([0, 0.15, -0.04])


@dataclass
class Planner:
    """Makes plans for one object, subject and table."""

    actor: Actor
    prop: StageProp
    holds: Holds
    table: Table
    rest: np.ndarray
    rng: np.random.Generator

    def make(self, intent: str) -> Performance:
        """Draw a plan and carry it out.

        Raises:
            InfeasibleError: this draw came to nothing.
        """
        return {"lift": self._lift, "pass": self._pass, "use": self._use, "offhand": self._offhand}[intent]()

    def _lift(self) -> Performance:
        hold, reach = self._place("right")
        stage = self._start(reach.thing)
        self._take(stage, hold, reach, first=True)
        for last in (False, True):
            up = self._carry(hold, reach.thing, (-0.2, 0.15, 0.25), (0.2, 0.35, 0.5), (0.25, 0.3), True)
            self._bring(stage, hold, up, "leave", self._seconds(0.7, 0.9))
            self._stay(stage, hold, up, self._seconds(0.15, 0.4))
            if last:
                self._put_down(stage, hold, reach)
                break
            again, there = self._place("right", also=hold)
            self._put_down(stage, hold, there._replace(swivels=there.swivels[1:]))
            self._let_go(stage, hold)
            self._take(stage, again, there, first=False)
            hold, reach = again, there
        self._let_go(stage, hold)
        self._leave(stage)
        return stage

    def _pass(self) -> Performance:
        hold, reach = self._place("right")
        stage = self._start(reach.thing)
        self._take(stage, hold, reach, first=True)
        away = self._carry(hold, reach.thing, (-0.3, 0.1, 0.5), (0.15, 0.35, 0.72), (0.25, 0.4))
        self._bring(stage, hold, away, "leave", self._seconds(1.0, 1.4))
        self._stay(stage, hold, away, self._seconds(0.4, 0.8))
        self._put_down(stage, hold, reach, self._seconds(1.0, 1.3))
        self._let_go(stage, hold)
        self._leave(stage)
        return stage

    def _use(self) -> Performance:
        use = use_of(self.prop.name)
        hold, reach = self._place("right")
        stage = self._start(reach.thing)
        self._take(stage, hold, reach, first=True)
        spread = tilt_of(use)
        if use.where == "front":
            goal = self._carry(hold, reach.thing, (-0.25, 0.15, 0.25), (0.1, 0.4, 0.5), spread)
        else:
            face = Face(self.actor, use.where)
            things = face.before(self.rng, self.prop, reach.thing.rotation, spread)
            near = lambda thing, trunk: face.brought(thing, trunk, self.prop, hold)  # noqa: E731
            goal = carry(self.actor, hold, self.prop, things, self.rng, lean=(-0.05, 0.3), accept=near)
        self._bring(stage, hold, goal, "leave", self._seconds(1.1, 1.4))
        turn, shift = motion_of(use, self.rng.uniform(0.7, 1.1))
        if use.where != "front":
            shift = shift * [1, 1, 0]
        path = sway(stage.resting(self._seconds(0.9, 1.4) + 0.25 * use.cycles), turn, shift, use.cycles)
        if use.where != "front" and turn.any():
            path = face.kept_out(path, self.prop, goal.trunk)
        self._follow(stage, hold, path, goal)
        self._put_down(stage, hold, reach, self._seconds(1.1, 1.4))
        self._let_go(stage, hold)
        self._leave(stage)
        return stage

    def _offhand(self) -> Performance:
        if "left" not in self.holds.sides:
            raise InfeasibleError("no left-hand grasps")
        takes = self._room().any(1).nonzero()[0]
        first, reach = place(self.actor, self.holds, "left", self.table, self.rest, self.rng, only=takes)
        stage = self._start(reach.thing)
        self._take(stage, first, reach, first=True, other_arm=self.actor.ready("right"))
        second, meet = self._hand_over(first, reach.thing)
        self._bring(stage, first, meet._replace(swivels=meet.swivels[:1]), "leave", self._seconds(1.0, 1.3))
        # The right hand comes while the left one holds still.
        before = second.approach(meet.thing)
        n_still = 1.0
        still = stage.resting(n_still)
        arm = stage.at("right", before, meet.swivels[1], meet.trunk)
        stage.move(
            n_still, left=Guided(still @ first.wrist, meet.swivels[0]), right=arm, fingers={"right": second.open},
            held="left",
        )  # fmt: skip
        for seconds, wrist, fingers, held in (
            (0.4, travel(before, meet.thing @ second.wrist, round(0.4 * FRAMERATE)), {}, "left"),
            (0.25, stage.resting(0.25) @ second.wrist, {"right": second.closed}, "left"),
            (0.2, stage.resting(0.2) @ second.wrist, {}, "both"),
            (0.25, stage.resting(0.25) @ second.wrist, {"left": first.open}, "right"),
        ):
            left = Guided(stage.resting(seconds) @ first.wrist, meet.swivels[0])
            stage.move(seconds, right=Guided(wrist, meet.swivels[1]), left=left, fingers=fingers, held=held)
        away = travel(meet.thing @ first.wrist, first.approach(meet.thing), round(0.4 * FRAMERATE))
        here = Guided(stage.resting(0.4) @ second.wrist, meet.swivels[1])
        stage.move(0.4, left=Guided(away, meet.swivels[0]), right=here, held="right")
        down = self._down_with(second)
        path = travel(stage.thing, down.thing, round(1.4 * FRAMERATE), "land")
        stage.move(
            1.4, trunk=down.trunk, thing=path, right=Guided(path @ second.wrist, down.swivels[0]),
            left=self.actor.ready("left"), fingers={"left": 0.3 * first.open}, held="right",
        )  # fmt: skip
        self._let_go(stage, second)
        self._leave(stage)
        return stage

    # --- Parts of plans ---

    def _place(self, side: str, also: Hold | None = None) -> tuple[Hold, Reach]:
        return place(self.actor, self.holds, side, self.table, self.rest, self.rng, also)

    def _carry(
        self, hold: Hold, thing: Pose, low: tuple, high: tuple, spread: tuple[float, float], above: bool = False
    ) -> Reach:
        """Somewhere in a box (metres from the pelvis, heights at least a hand above the table)."""
        outward = self.actor.arms[hold.side].outward * -1
        low, high = np.array(low, float), np.array(high, float)
        low[0], high[0] = sorted((low[0] * outward, high[0] * outward))
        lowest = self.table.top + 0.12 + np.ptp(self.prop.vertices @ self.rest[2]) / 2
        low[1] = lowest if above else max(low[1], lowest)
        high[1] = max(low[1] + 0.2, high[1])
        things = somewhere(self.rng, self.prop, thing.rotation, low, high, *spread)
        return carry(self.actor, hold, self.prop, things, self.rng, self.table)

    def _start(self, thing: Pose) -> Performance:
        stage = Performance(self.actor, thing)
        stage.move(0.1)
        return stage

    def _take(
        self, stage: Performance, hold: Hold, reach: Reach, first: bool, other_arm: np.ndarray | None = None
    ) -> None:
        """Come to the object on the table and close the hand; the other arm goes to `other_arm`, or hangs."""
        before, swivel = hold.approach(reach.thing), reach.swivels[0]
        other = "left" if hold.side == "right" else "right"
        above = Pose(before.rotation, before.position + _ABOVE)
        if other_arm is None:
            other_arm = self.actor.hanging(other)
        arms = {hold.side: stage.at(hold.side, above, swivel, reach.trunk), other: other_arm}
        relaxed = {hold.side: hold.open, other: 0.3 * hold.open}
        stage.move(self._seconds(1.1, 1.4) if first else 0.65, reach.trunk, **arms, fingers=relaxed)
        stage.move(0.35, **{hold.side: Guided(travel(above, before, round(0.35 * FRAMERATE)), swivel)})
        path = travel(before, reach.thing @ hold.wrist, round(0.4 * FRAMERATE))
        stage.move(0.4, **{hold.side: Guided(path, swivel)})
        still = Guided(stage.resting(0.25) @ hold.wrist, swivel)
        stage.move(0.25, **{hold.side: still}, fingers={hold.side: hold.closed})

    def _bring(self, stage: Performance, hold: Hold, goal: Reach, rise: str, seconds: float) -> None:
        path = travel(stage.thing, goal.thing, round(seconds * FRAMERATE), rise)
        self._follow(stage, hold, path, goal)

    def _follow(self, stage: Performance, hold: Hold, path: Pose, goal: Reach) -> None:
        """The object goes along a path, the hand with it."""
        guided = Guided(path @ hold.wrist, goal.swivels[0])
        stage.move(len(path.position) / FRAMERATE, goal.trunk, **{hold.side: guided}, thing=path, held=hold.side)

    def _stay(self, stage: Performance, hold: Hold, goal: Reach, seconds: float) -> None:
        self._follow(stage, hold, stage.resting(seconds), goal)

    def _put_down(self, stage: Performance, hold: Hold, reach: Reach, seconds: float = 0.8) -> None:
        self._bring(stage, hold, reach, "land", seconds)

    def _let_go(self, stage: Performance, hold: Hold) -> None:
        """Open the hand and take it back; the object stays."""
        swivel = stage.swivel(hold.side)
        still = Guided(stage.resting(0.25) @ hold.wrist, swivel)
        stage.move(0.25, **{hold.side: still}, fingers={hold.side: hold.open})
        path = travel(stage.thing @ hold.wrist, hold.approach(stage.thing), round(0.4 * FRAMERATE))
        stage.move(0.4, **{hold.side: Guided(path, swivel)})
        before = hold.approach(stage.thing)
        above = Pose(before.rotation, before.position + _ABOVE)
        stage.move(0.3, **{hold.side: Guided(travel(before, above, round(0.3 * FRAMERATE)), swivel)})

    def _leave(self, stage: Performance) -> None:
        """Back to T-pose."""
        stage.move(1.4, UPRIGHT, _T_POSE, _T_POSE, {"right": FLAT, "left": FLAT})
        stage.move(0.1)

    def _down_with(self, hold: Hold) -> Reach:
        """Where the right hand can put down what it has taken over."""
        n, outward = 4000, self.actor.arms[hold.side].outward
        radius = np.linalg.norm((self.prop.vertices - self.prop.vertices.mean(0))[:, :2], axis=1).max()
        low = (min(-0.1 * outward, 0.35 * outward), 0, 0.29 + radius)
        high = (max(-0.1 * outward, 0.35 * outward), 0, 0.5 + radius)
        things = somewhere(self.rng, self.prop, self._upright(n), low, high, 0, 0, n)
        things.position[:, 1] = self.table.top - (self.prop.vertices @ self.rest[2]).min()
        return carry(self.actor, hold, self.prop, things, self.rng, self.table, (0, 0.75))

    def _upright(self, n: int) -> np.ndarray:
        """(N, 3, 3) rotations in which the object rests, at any heading."""
        headings = self.rng.uniform(-np.pi, np.pi, n)
        return Rotation.from_rotvec(headings[:, None] * [0, 1, 0]).as_matrix() @ UP @ self.rest

    def _room(self) -> np.ndarray:
        """(N, N) whether a left grasp leaves a right one room, and that one can put the object down afterwards."""
        return (self.holds.apart > _ROOM) & self.holds.clears("right", self.rest)

    def _hand_over(self, first: Hold, thing: Pose, n: int = 15000, tries: int = 20) -> tuple[Hold, Reach]:
        """A place before the chest, and a grasp of the right hand that leaves the left one room."""
        actor = self.actor
        things = somewhere(self.rng, self.prop, thing.rotation, (-0.15, 0.12, 0.25), (0.15, 0.4, 0.48), 0.7, 1.5, n)
        free = self._room()[first.number].nonzero()[0]
        grasp = self.rng.choice(free, n)
        right = self.holds.wrist["right"]
        draws: Draws = draw_trunks(self.rng, n, 2, (-0.05, 0.25))
        total = trunk_effort(draws.trunk)
        total += hand_effort(actor, "left", things @ first.wrist, draws, 0, self.table, thing_offset(things, first))
        second = Pose(right.rotation[grasp], right.position[grasp])
        total += hand_effort(actor, "right", things @ second, draws, 1, self.table, None)
        total += 0.2 * self.rng.gumbel(size=n)
        own = actor.hand_vertices("left", _one(first.wrist), np.stack([first.closed]))[0]
        tree = cKDTree(own)
        tried: set[int] = set()
        for i in np.argsort(total):
            if np.isinf(total[i]) or len(tried) >= tries:
                break
            if int(grasp[i]) in tried:
                continue  # whether hands have room does not depend on where the object is
            tried.add(int(grasp[i]))
            hold = self.holds.hold(
                "right", int(grasp[i]), self.rest[2], float((self.prop.vertices @ self.rest[2]).min())
            )
            if hold is None:
                continue
            steps = np.linspace(0, 1, 4)
            wrists = Pose(
                np.tile(hold.wrist.rotation, (5, 1, 1)), hold.wrist.position + np.append(steps, 0)[:, None] * hold.back
            )
            angles = np.stack([hold.open] * 4 + [hold.closed])
            vertices = actor.hand_vertices("right", wrists, angles).reshape(-1, 3)
            nearest = tree.query(vertices)[0].reshape(5, -1).min(1)
            if nearest[4] < _HANDS_APART or nearest.min() < _HANDS_APART / 2:
                continue
            thing = Pose(things.rotation[i], things.position[i])
            trunk = look_at(actor, draws.trunk[i], thing.points(self.prop.vertices.mean(0)[None])[0])
            return hold, Reach(thing, trunk, tuple(float(x) for x in draws.swivel[i]))
        raise InfeasibleError("no grasp to take it over with")

    def _seconds(self, low: float, high: float) -> float:
        return round(self.rng.uniform(low, high), 2)


def _one(pose: Pose) -> Pose:
    return Pose(pose.rotation[None], pose.position[None])
