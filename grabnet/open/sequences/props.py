"""What the sequences need of an object: distances, ways to lie on a table, and how a subject's hands hold it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
import trimesh

from grabnet.body.anatomy import FINGERS
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.sdf_grid import SDFGrid
from grabnet.open.grasps.store import OpenGrasps
from grabnet.open.sequences.actor import Actor
from grabnet.open.sequences.motion import Pose

UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # from z up to y up
_OPENINGS = (0.45, 0.2, 0.7)  # shares of a grasp's flexion that open hands keep, in the order of trial
# Recorded hands are millimetres deep in the objects that they hold, since flesh gives way and body models do not (on
# average 3.25 mm in the paper). Metres that each finger is pressed in, the least that counts as pressed (thin walls
# allow less), and what is tried to get there: radians added to the flexion of its joints.
_PRESSED, _BARELY_PRESSED = 0.0045, 0.0035
_PRESSES = np.arange(0, 0.45, 0.02)
_RELEASES = -np.arange(0, 0.21, 0.01)
_AWAY = 0.11  # metres from where an approach starts to the grasp
_STEPS = np.array([0.0, 0.012, 0.03, 0.06, _AWAY])
# Metres that a hand may be in the table: with a grasp as it was synthesised, and while it presses and closes.
_ON_TABLE, _INTO_TABLE = 0.0005, 0.002


@dataclass(frozen=True)
class Hold:
    """How one hand holds the object.

    number: of the grasp. wrist: its pose in the object's frame. closed, open: (21,) angles in the grasp, and while the
    hand comes and goes.
    back: (3,) offset in the object's frame, from the grasp to where the approach starts.
    """

    side: str
    number: int
    wrist: Pose
    closed: np.ndarray
    open: np.ndarray
    back: np.ndarray

    def approach(self, thing: Pose) -> Pose:
        """Where the wrist is before it comes, the object being at `thing`."""
        return thing @ Pose(self.wrist.rotation, self.wrist.position + self.back)


class StageProp:
    """One object as the sequences use it; its own frame is z up."""

    def __init__(self, name: str, mesh: Mesh):
        self.name, self.mesh = name, mesh
        self.vertices = mesh.vertices.astype(np.float64)
        self.atlas = SDFAtlas([SDFGrid.load_or_build(mesh)])

    def distance(self, points: np.ndarray) -> np.ndarray:
        """(N,) signed distances of points (N, 3) of the object's frame, metres, negative inside."""
        points = torch.as_tensor(np.asarray(points, np.float32)).reshape(1, -1, 3)
        return self.atlas(points, torch.zeros(1, dtype=torch.int64))[0].numpy()

    @cached_property
    def rests(self) -> list[np.ndarray]:
        """Rotations (3, 3), z up, in which it lies still: as modelled first, then others, likeliest first."""
        solid = trimesh.Trimesh(self.vertices, self.mesh.faces, process=False).convex_hull
        found = [np.eye(3)]
        for rotation, _ in zip(*trimesh.poses.compute_stable_poses(solid, threshold=0.01), strict=True):
            if all(abs(rotation[2, :3] @ other[2]) < 0.97 for other in found):
                found.append(rotation[:3, :3])
        return found[:4]

    @cached_property
    def mirror(self) -> tuple[np.ndarray, np.ndarray] | None:
        """A plane of symmetry as signs (3,) and offset (3,): x → signs x + offset; None if there is none."""
        low, high = self.mesh.bounds.astype(np.float64)
        some = self.vertices[:: max(1, len(self.vertices) // 2000)]
        for axis in (1, 0):
            signs, offset = np.ones(3), np.zeros(3)
            signs[axis], offset[axis] = -1, low[axis] + high[axis]
            if np.abs(self.distance(some * signs + offset)).max() < 0.0015:
                return signs, offset
        return None


class Holds:
    """The open grasps of one object by one subject, with either hand.

    Attributes:
        wrist[side]: N poses of the wrist in the object's frame. angles (N, 21). sides: those there are.
    """

    def __init__(self, prop: StageProp, actor: Actor, grasps: OpenGrasps):
        self.prop, self.actor = prop, actor
        number, subject = grasps.objects.index(prop.name), grasps.subjects.index(actor.subject.name)
        index = ((grasps.object == number) & (grasps.subject == subject)).nonzero().squeeze(1)
        parameters = grasps.parameters(actor.anatomy, index)
        rotation = parameters.global_orient.double().numpy()
        position = parameters.transl.double().numpy() + actor.hand_wrist
        self.angles = grasps.angles[index].double().numpy()
        self.wrist = {"right": Pose(rotation, position)}
        if prop.mirror:
            signs, offset = prop.mirror
            # A reflected hand is the other hand: its own frame is reflected in x as well.
            turned = signs[:, None] * rotation * np.array([-1, 1, 1])
            self.wrist["left"] = Pose(turned, position * signs + offset)
        self._vertices = {
            side: actor.hand_vertices(side, wrist, self.angles) if len(index) else np.zeros((0, 778, 3))
            for side, wrist in self.wrist.items()
        }

    @property
    def sides(self) -> tuple[str, ...]:
        return tuple(self.wrist)

    def __len__(self) -> int:
        return len(self.angles)

    def clears(self, side: str, rest: np.ndarray) -> np.ndarray:
        """(N,) whether each grasp leaves the hand above the table on which the object lies, turned by `rest`."""
        table = (self.prop.vertices @ rest[2]).min()
        return (self._vertices[side] @ rest[2]).min(1) > table - _ON_TABLE

    @cached_property
    def apart(self) -> np.ndarray:
        """(N, N) metres, about, between the hands of each left grasp (row) and each right one (column)."""
        left, right = (torch.as_tensor(self._vertices[side][:, ::4].copy()) for side in ("left", "right"))
        return np.stack([torch.cdist(one[None], right).amin((1, 2)).numpy() for one in left])

    def hold(self, side: str, k: int, up: np.ndarray | None = None, table: float = 0.0) -> Hold | None:
        """The k-th grasp with a way for the open hand to get there, or None if every way cuts through the object.

        Args:
            up: (3,) of the world in the object's frame, to stay above a table at `table` along it; no table if omitted.
        """
        wrist = Pose(self.wrist[side].rotation[k], self.wrist[side].position[k])
        closed = self.pressed(side, k)
        x, y = wrist.rotation[:, 0] * (1 if side == "right" else -1), wrist.rotation[:, 1]  # backwards; off the palm
        ways = [y, x + y, x, 0.4 * x + y, x + 0.4 * y]
        if up is not None:
            ways += [up, up + x, up + y]
        best: tuple[float, Hold] | None = None
        for share in _OPENINGS:
            opened = self.opened(closed, share)
            if up is not None and self._lowest(side, wrist, np.linspace(opened, closed, 4), up) < table - _INTO_TABLE:
                continue
            for way in ways:
                back = _AWAY * way / np.linalg.norm(way)
                moved = Pose(np.tile(wrist.rotation, (5, 1, 1)), wrist.position + _STEPS[:, None] / _AWAY * back)
                vertices = self.actor.hand_vertices(side, moved, np.tile(opened, (5, 1)))
                if up is not None and (vertices @ up).min() < table + 0.002:
                    continue
                depth = self.prop.distance(vertices.reshape(-1, 3)).min()
                if best is None or depth > best[0] + 0.0005:
                    best = depth, Hold(side, k, wrist, closed, opened, back)
            if best and best[0] > -0.002:
                break
        return best[1] if best and best[0] > -0.004 else None

    def _lowest(self, side: str, wrist: Pose, angles: np.ndarray, up: np.ndarray) -> float:
        """Height along `up` of the lowest vertex of a hand at one place, with (N, 21) angles."""
        still = Pose(np.tile(wrist.rotation, (len(angles), 1, 1)), np.tile(wrist.position, (len(angles), 1)))
        return float((self.actor.hand_vertices(side, still, angles) @ up).min())

    def pressed(self, side: str, k: int) -> np.ndarray:
        """(21,) angles of the k-th grasp, the fingers that touch pressed into the object as flesh would be.

        A finger on a wall too thin for that is laid on the surface instead.
        """
        anatomy, closed = self.actor.anatomy, self.angles[k].copy()
        bends = np.array([n.endswith(("flexion", "pip", "dip", "_mcp", "_ip")) for n in anatomy.angle_names])
        changes = np.concatenate([_PRESSES, _RELEASES])
        wrist, n = self.wrist[side], len(changes)
        wrist = Pose(np.tile(wrist.rotation[k], (n, 1, 1)), np.tile(wrist.position[k], (n, 1)))
        tried = closed + changes[:, None] * bends
        vertices = self.actor.hand_vertices(side, wrist, tried)
        depth = -self.prop.distance(vertices.reshape(-1, 3)).reshape(n, -1)
        beyond_base = (anatomy.bone.numpy() - 1) % 3 > 0  # the base of the thumb is part of the palm
        for finger, name in enumerate(FINGERS):
            own = depth[:, (anatomy.finger.numpy() == finger) & beyond_base].max(1)
            press, release = own[: len(_PRESSES)], own[len(_PRESSES) :]
            if own[0] < -0.003:
                continue  # it does not touch
            # Pressing ends where it is deep enough, or gets no deeper: halfway through a wall.
            good = (press[1:] <= _PRESSED) & (press[1:] > press[:-1] + 2e-5)
            step = len(good) if good.all() else int(good.argmin())
            if press[step] < _BARELY_PRESSED:
                clear = (release < -1e-4).nonzero()[0]
                step = len(_PRESSES) + int(clear[0]) if len(clear) else 0
            angles = [name in n for n in anatomy.angle_names]
            closed[angles] = tried[step, angles]
        return closed

    def opened(self, closed: np.ndarray, share: float) -> np.ndarray:
        """(21,) angles of a hand that is opened to a share of its flexion."""
        flexion = np.array([not n.endswith(("abduction", "twist")) for n in self.actor.anatomy.angle_names])
        return np.where(flexion, closed * share, closed)
