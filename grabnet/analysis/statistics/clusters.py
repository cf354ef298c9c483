"""Typical grasps of each object, and whether they avoid its markers (paper S.10, Fig. S.10)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import trimesh
from matplotlib.figure import Figure
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from grabnet.analysis.frames import ALL, Frames, Group, Subset
from grabnet.analysis.plots import tiled
from grabnet.analysis.rules import Rules
from grabnet.analysis.statistic import Analysed, Row, Statistic
from grabnet.body.skeleton import RIGHT_HAND_PARTS
from grabnet.contact.contacts import CONTACT_DISTANCE
from grabnet.geometry.mesh import Mesh
from grabnet.visual.pictures import OBJECT, SKIN, Shape, can_render, render

_TILE = (130, 130)
# Metres, root mean square over the hand's vertices: grasps no further apart get no clusters of their own.
_ALIKE = 0.001
_STORED = np.float16  # within 0.5 m off by 0.12 mm at most
# Every so many of the hand's vertices describe it; all of them cluster the same, and slower.
_THIN = 8


class Cluster(NamedTuple):
    """Grasps alike: how many, the hand nearest to their mean (V, 3), and how many markers it touches."""

    grasps: int
    hand: np.ndarray
    markers: int


class Clusters(Statistic):
    """k-means of right-hand grasps of each object, by where the hand's vertices are on it."""

    name = "clusters"
    title = "Clusters of grasps"
    about = (
        "k-means of the right hand's vertices in the object's frame, over a sample of the contact frames that it takes "
        "part in; shown, with the number of grasps, is the grasp nearest to each centre, the largest cluster first. A "
        "cluster touches markers where that hand is within 4.5 mm of one (●; red: the markers; paper S.10)."
    )

    by = ("object",)

    def __init__(self, rules: Rules):
        super().__init__(rules)
        # (M, 3) metres in the object's frame, of each object whose layout is known.
        self.markers: Mapping[str, np.ndarray] = {}

    def add(self, frames: Frames) -> None:
        contact = frames.contact_frames(self.rules.min_lift, self.rules.min_body_vertices)
        there = (contact & frames.touching(RIGHT_HAND_PARTS)).nonzero()[0]
        n = min(len(there), self.rules.grasps_per_sequence)
        if n:
            chosen = there[np.linspace(0, len(there) - 1, n).astype(int)]
            self._keep(frames.group, _ranks(frames.name, chosen), frames.surfaces["hands"][0](chosen).numpy())

    def merge(self, other: Statistic) -> None:
        for group in other.groups(ALL):
            self._keep(group, other.sums[group, "ranks"], other.sums[group, "hands"])

    def _keep(self, group: Group, ranks: np.ndarray, hands: np.ndarray) -> None:
        """Add grasps; of too many those of the lowest ranks stay, in whatever order they come."""
        if (group, "ranks") in self.sums:
            ranks = np.concatenate([self.sums[group, "ranks"], ranks])
            hands = np.concatenate([self.sums[group, "hands"], hands])
        order = np.argsort(ranks)[: self.rules.grasps_per_object]
        self.sums[group, "ranks"], self.sums[group, "hands"] = ranks[order], hands[order].astype(_STORED)

    def clusters(self, subset: Subset, name: str) -> list[Cluster]:
        """Clusters of the grasps of an object, the largest first; none without grasps."""
        markers = self.markers.get(name)
        groups = self.groups(Subset(subset.intents, subset.subjects, [name]))
        if not groups:
            return []
        ranks = np.concatenate([self.sums[group, "ranks"] for group in groups])
        hands = np.concatenate([self.sums[group, "hands"] for group in groups]).astype(np.float32)
        hands = hands[np.argsort(ranks)[: self.rules.grasps_per_object]]
        features = hands[:, ::_THIN].reshape(len(hands), -1).astype(np.float64)
        k = min(self.rules.clusters, _distinct(features))
        centres, label = kmeans2(features, k, minit="++", seed=np.random.default_rng(self.rules.seed))
        found = []
        for number in np.unique(label):
            own = (label == number).nonzero()[0]
            hand = hands[own[np.linalg.norm(features[own] - centres[number], axis=1).argmin()]]
            touched = 0 if markers is None else int((cKDTree(hand).query(markers)[0] <= CONTACT_DISTANCE).sum())
            found.append(Cluster(len(own), hand, touched))
        return sorted(found, key=lambda cluster: -cluster.grasps)

    def result(self, subset: Subset) -> list[Row]:
        rows = []
        for name in sorted({group.object for group in self.groups(subset)}):
            markers = self.markers.get(name)
            found = self.clusters(subset, name)
            row: Row = {"object": name, "grasps": sum(c.grasps for c in found), "clusters": len(found)}
            row |= {"largest cluster [%]": 100 * found[0].grasps / row["grasps"]}
            row["markers"] = None if markers is None else len(markers)
            touching = sum(c.markers > 0 for c in found)
            rows.append(row | {"clusters touching markers": None if markers is None else touching})
        return rows

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        if can_render():
            return None
        tiles, lines, captions = [], [], []
        for each in analysed:
            faces, statistic = each.data.hand().faces.numpy(), each.statistics[cls.name]
            for name in sorted({group.object for group in statistic.groups(ALL)}):
                mesh = each.data.object_mesh(name)
                found = statistic.clusters(ALL, name)
                still = [Shape(mesh.vertices, mesh.faces, OBJECT), *_dots(statistic.markers.get(name), mesh)]
                # A hand that is on markers would hide them.
                hands = [Shape(c.hand, faces, SKIN, 0.6 if c.markers else 1.0) for c in found]
                tiles.append([render([*still, hand], size=_TILE) for hand in hands])
                captions.append([f"{c.grasps}" + " ●" * (c.markers > 0) for c in found])
                lines.append(f"{each.label}\n{name}")
        if not tiles:
            return None
        columns = max(map(len, tiles))
        tiles = [line + [None] * (columns - len(line)) for line in tiles]
        captions = [line + [""] * (columns - len(line)) for line in captions]
        return tiled(tiles, lines, [f"{k + 1}" for k in range(columns)], captions=captions, size=0.9)


def _distinct(features: np.ndarray) -> int:
    """How many of (N, F) grasps, one after the other, are unlike all before them."""
    leaders = features[:1]
    for one in features[1:]:
        if (np.sqrt(3 * ((leaders - one) ** 2).mean(1)) > _ALIKE).all():
            leaders = np.concatenate([leaders, one[None]])
    return len(leaders)


def _dots(markers: np.ndarray | None, mesh: Mesh) -> list[Shape]:
    """Red balls at markers (M, 3), larger than they are, to be seen."""
    if markers is None:
        return []
    ball = trimesh.creation.icosphere(1, max(0.003, 0.025 * float(np.ptp(mesh.vertices, 0).max())))
    vertices = (markers[:, None] + ball.vertices).reshape(-1, 3)
    faces = (len(ball.vertices) * np.arange(len(markers))[:, None, None] + ball.faces).reshape(-1, 3)
    return [Shape(vertices, faces, (0.85, 0.15, 0.1))]


def _ranks(name: str, frames: np.ndarray) -> np.ndarray:
    """(N,) uint64, as if at random, of frames of a sequence."""
    digests = [hashlib.blake2b(f"{name} {frame}".encode(), digest_size=8).digest() for frame in frames]
    return np.frombuffer(b"".join(digests), np.uint64)
