"""Synthetic captures: marker files with the faults of real ones, whose truth is known (paper S.8)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from torch import Tensor

from grabnet.body.anatomy import vertex_normals
from grabnet.body.skeleton import JOINTS
from grabnet.body.whole import BodyModel
from grabnet.cli.checks import Amount, Positive, Share, Weight, in_range
from grabnet.data.sequences import BodyTrack, Sequence
from grabnet.mosh.layouts import Layout, ObjectLayout
from grabnet.mosh.placing import marker_positions

_BATCH = 64  # frames posed at once
_JAW = JOINTS.index("jaw")


@dataclass(frozen=True)
class Flaws:
    """What is wrong with a capture.

    Attributes:
        noise: standard deviation of each coordinate, metres.
        dropped: markers missing in a frame at most, chosen frame by frame.
        bursts: share of all marker positions that are missing in runs.
        burst_seconds: length of a run, at most.
        swapped: share of all marker positions that carry the label of a marker nearby, in runs.
        ghosts: share of marker positions that are somewhere else, within 15 cm.

    Raises:
        UserError: a value out of range.
    """

    noise: Weight = 0.001
    dropped: Amount = 5
    bursts: Share = 0.0
    burst_seconds: Positive = 0.4
    swapped: Share = 0.0
    ghosts: Share = 0.0

    def __post_init__(self):
        in_range(self, "conditions.")


def in_one_ring(layout: Layout, faces: np.ndarray, seed: int) -> Layout:
    """Each marker moved to a random place of the faces around its vertex, evenly by barycentric weights (paper S.8)."""
    rng = np.random.default_rng([seed, 1])
    markers = []
    for marker in layout.markers:
        around = faces[(faces == marker.vertices[0]).any(1)]
        face = around[rng.integers(len(around))]
        weights = rng.dirichlet(np.ones(3))
        corners = tuple(int(v) for v in face)
        markers.append(replace(marker, vertices=corners, weights=tuple(float(w) for w in weights)))
    return Layout(layout.name, layout.n_vertices, tuple(markers))


def with_moving_face(sequence: Sequence, seed: int, n_expressions: int = 0) -> Sequence:
    """A recording whose jaw and expression move, smoothly and at random; those of the open bodies keep still.

    Args:
        sequence: a recording.
        seed: of the motion.
        n_expressions: expression values that move; the others are 0.
    """
    rng = np.random.default_rng([seed, 2])
    n, width = len(sequence), 0.12 * sequence.framerate
    noise = gaussian_filter1d(rng.normal(0, 1, (n + 200, 2 + n_expressions)), width, axis=0, mode="wrap")[100 : n + 100]
    noise /= np.sqrt(1 / (2 * np.sqrt(np.pi) * width))
    opened = np.stack([np.clip(0.12 + 0.12 * noise[:, 0], 0, 0.45), 0.03 * noise[:, 1], np.zeros(n)], 1)
    expression = np.zeros_like(sequence.body.expression)
    expression[:, :n_expressions] = noise[:, 2:]
    fullpose = sequence.body.fullpose.copy()
    fullpose[:, 3 * _JAW : 3 * _JAW + 3] = opened
    body = replace(
        sequence.body, jaw_pose=opened.astype(np.float32), fullpose=fullpose, expression=expression.astype(np.float32)
    )
    return replace(sequence, body=body)


@torch.no_grad()
def posed_vertices(
    track: BodyTrack, body: BodyModel, v_template: Tensor, frames: np.ndarray | None = None
) -> Iterator[Tensor]:
    """Vertices (B, V, 3) of a recording's body, some frames after the others."""
    chosen = np.arange(len(track.transl)) if frames is None else frames
    for start in range(0, len(chosen), _BATCH):
        now = chosen[start : start + _BATCH]
        expression = torch.as_tensor(track.expression[now][:, : body.n_expressions])
        rest = body.shaped(v_template=v_template, expression=expression) if expression.any() else v_template
        yield body(track.parameters(now), rest).vertices


class OnSkin:
    """Markers on a body, wherever it is.

    Args:
        layout: where they sit.
        faces: (F, 3) of the body.
    """

    def __init__(self, layout: Layout, faces: Tensor):
        corners = torch.tensor([marker.vertices for marker in layout.markers])
        faces = faces[torch.isin(faces, corners).any(1)]  # their normals need no others
        self._around, self._faces = faces.unique(return_inverse=True)
        own = torch.searchsorted(self._around, corners).tolist()
        markers = zip(layout.markers, own, strict=True)
        self._layout = replace(layout, markers=tuple(replace(marker, vertices=tuple(at)) for marker, at in markers))

    def __call__(self, vertices: Tensor) -> np.ndarray:
        """(B, M, 3) float64 of bodies (B, V, 3)."""
        near = vertices[:, self._around].double()
        return marker_positions(self._layout, near.numpy(), vertex_normals(near, self._faces).numpy())


def clean_markers(sequence: Sequence, body: BodyModel, v_template: Tensor, layout: Layout) -> np.ndarray:
    """(T, M, 3) where the markers are, free of noise; float64."""
    on_skin = OnSkin(layout, body.faces)
    return np.concatenate([on_skin(vertices) for vertices in posed_vertices(sequence.body, body, v_template)])


def object_markers(sequence: Sequence, layout: ObjectLayout) -> np.ndarray:
    """(T, M, 3) where the object's markers are, free of noise; float64."""
    turned = Rotation.from_rotvec(sequence.object.global_orient.astype(np.float64)).inv().as_matrix()
    return layout.positions @ turned.swapaxes(1, 2) + sequence.object.transl[:, None].astype(np.float64)


def spoilt(positions: np.ndarray, rate: float, flaws: Flaws, seed: int, hidden: np.ndarray | None = None) -> np.ndarray:
    """Markers (T, M, 3) as a capture would have them; those that are `hidden` (T, M) from the cameras are missing."""
    rng = np.random.default_rng([seed, 3])
    n, m, _ = positions.shape
    found = positions + rng.normal(0, flaws.noise, positions.shape)
    if hidden is not None:
        found[hidden] = np.nan
    for t in range(n):
        found[t, rng.choice(m, rng.integers(0, min(flaws.dropped, m) + 1), replace=False)] = np.nan
    mean_length = max(1, round(flaws.burst_seconds * rate / 2))
    for _ in range(round(flaws.bursts * n * m / mean_length)):
        start, length = rng.integers(-mean_length, n), rng.integers(1, 2 * mean_length + 1)
        found[max(0, start) : start + length, rng.integers(m)] = np.nan
    _swap(found, positions, round(flaws.swapped * n * m / 2), mean_length, rng)
    for t, k in zip(*(rng.random((n, m)) < flaws.ghosts).nonzero(), strict=True):
        found[t, k] = positions[t, k] + rng.uniform(-0.15, 0.15, 3)
    return found


def _swap(found: np.ndarray, positions: np.ndarray, n_frames: int, length: int, rng: np.random.Generator) -> None:
    """Exchange labels of a marker and one of its three nearest, in runs of `n_frames` frames altogether."""
    while n_frames > 0:
        run = min(n_frames, int(rng.integers(1, 2 * length + 1)), len(found))
        start = rng.integers(0, len(found) - run + 1)
        one = rng.integers(found.shape[1])
        other = np.argsort(np.linalg.norm(positions[start] - positions[start, one], axis=1))[rng.integers(1, 4)]
        now = slice(start, start + run)
        found[now, [one, other]] = found[now, [other, one]]
        n_frames -= run
