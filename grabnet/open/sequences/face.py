"""Bringing things to the head: to the mouth, the eyes or an ear, until they all but touch it."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from grabnet.body.skeleton import JOINTS
from grabnet.open.sequences.actor import Actor
from grabnet.open.sequences.motion import Pose
from grabnet.open.sequences.props import Hold, StageProp

_GAP = 0.002  # metres left between object and head
_HAND_GAP = 0.008  # metres, at least, from the hand's vertices to the head's
_FAR = 0.30  # metres from which the object comes
_STEP = 0.004


class Face:
    """A place on an actor's head; at rest, as the trunk is upright.

    Args:
        where: mouth, eyes or ear (the right one).
    """

    def __init__(self, actor: Actor, where: str):
        self.actor = actor
        weights = actor.body.weights.numpy()
        head = np.isin(weights.argmax(1), [JOINTS.index(j) for j in ("head", "jaw", "left_eye", "right_eye", "neck")])
        self.vertices = actor.v_template.numpy()[head].astype(np.float64)
        eyes = actor.joints[[JOINTS.index("left_eye"), JOINTS.index("right_eye")]].mean(0)
        # Directions from the head towards where the object comes from.
        self.way = {"mouth": (0, -0.25, 1), "eyes": (0, 0, 1), "ear": (-1, -0.1, 0.15)}[where]
        self.way = np.array(self.way, float) / np.linalg.norm(self.way)
        self.target = {
            "mouth": eyes + np.array([0, -0.068, 0.01]),
            "eyes": eyes,
            "ear": np.array([self.vertices[:, 0].min(), eyes[1] - 0.01, actor.joints[15, 2] + 0.02]),
        }[where]
        self._joint = actor.joints[15]

    def before(
        self,
        rng: np.random.Generator,
        prop: StageProp,
        rotation: np.ndarray,
        spread: tuple[float, float],
        n: int = 3000,
    ) -> Pose:
        """N poses about where the object will be, for upright trunks."""
        tilt, turn = spread
        turned = Rotation.from_rotvec(rng.normal(0, 1, (n, 3)) * [tilt, turn, tilt]).as_matrix() @ rotation
        middle = prop.vertices.mean(0)
        size = np.ptp((prop.vertices - middle)[::50] @ np.swapaxes(turned, 1, 2) @ self.way, axis=1) / 2
        at = self.target + (size + 0.02)[:, None] * self.way + rng.normal(0, 0.012, (n, 3))
        return Pose(turned, at - turned @ middle)

    def brought(self, thing: Pose, trunk: np.ndarray, prop: StageProp, hold: Hold) -> Pose | None:
        """The object moved along the way to the face until it or the hand all but touches; None if it stays far off."""
        head = self.actor.trunk(trunk[None]).head
        head = Pose(head.rotation[0], head.position[0])
        # Where the object would be, had the head gone along with the trunk.
        carried = head.rotation @ (thing.points(prop.vertices.mean(0)[None])[0] - self._joint) + head.position
        rotation, way = thing.rotation, head.rotation @ self.way
        skin = head.points(self.vertices - self._joint)
        hand = self.actor.hand_vertices(
            hold.side, Pose(hold.wrist.rotation[None], hold.wrist.position[None]), hold.closed[None]
        )[0]
        start = carried + _FAR * way - rotation @ prop.vertices.mean(0)
        low, high = self.actor_bounds(prop)
        steps = np.arange(0, _FAR + 0.05, _STEP)
        placed = None
        for step in steps:
            here = Pose(rotation, start - step * way)
            local = here.inverse().points(skin)
            near = ((local > low) & (local < high)).all(1)
            if near.any() and prop.distance(local[near]).min() < _GAP + _STEP / 2:
                break
            if _nearest(hand, local) < _HAND_GAP + _STEP / 2:
                break
            placed = here
        if placed is None:
            return None
        reached = np.abs(prop.distance(placed.inverse().points(skin))).min()
        return placed if reached < 0.02 else None

    def kept_out(self, path: Pose, prop: StageProp, trunk: np.ndarray) -> Pose:
        """A path moved away from the face as far as it would go into it."""
        head = self.actor.trunk(trunk[None]).head
        head = Pose(head.rotation[0], head.position[0])
        skin, way = head.points(self.vertices - self._joint), head.rotation @ self.way
        low, high = self.actor_bounds(prop)
        depth = np.zeros(len(path.position))
        for i in range(0, len(depth), 4):
            local = Pose(path.rotation[i], path.position[i]).inverse().points(skin)
            near = ((local > low) & (local < high)).all(1)
            if near.any():
                depth[i : i + 4] = max(0.0, _GAP - prop.distance(local[near]).min())
        width = 25
        padded = np.pad(depth, width, mode="edge")
        # An upper envelope, made smooth: never less than the depth itself.
        envelope = np.array([padded[i : i + 2 * width + 1].max() for i in range(len(depth))])
        kernel = np.hanning(width) / np.hanning(width).sum()
        smooth = np.convolve(np.pad(envelope, width, mode="edge"), kernel, "same")[width:-width]
        smooth = smooth - np.linspace(smooth[0], smooth[-1], len(smooth))
        return Pose(path.rotation, path.position + 1.2 * smooth[:, None] * way)

    @staticmethod
    def actor_bounds(prop: StageProp) -> tuple[np.ndarray, np.ndarray]:
        low, high = prop.mesh.bounds.astype(np.float64)
        return low - 0.03, high + 0.03


def _nearest(points: np.ndarray, others: np.ndarray) -> float:
    """Smallest distance between two sets of points; far ones are not looked at closely."""
    low, high = points.min(0) - 0.02, points.max(0) + 0.02
    near = others[((others > low) & (others < high)).all(1)]
    if not len(near):
        return 0.02
    return float(torch.cdist(torch.as_tensor(points), torch.as_tensor(near)).min())
