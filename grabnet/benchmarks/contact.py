"""Contact of a body with an object, frame by frame, against the same searches in SciPy and trimesh."""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from joblib import Parallel, delayed
from scipy.spatial import cKDTree

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import hands, meshes
from grabnet.benchmarks.timing import Case
from grabnet.body.anatomy import Anatomy
from grabnet.body.skeleton import PARTS, RIGHT_HAND_PARTS
from grabnet.contact.annotator import ContactAnnotator
from grabnet.geometry.mesh import Mesh
from grabnet.preprocess.backends import machine_cores

EPSILON = 0.0045
# Metres by which the fingertip that touches first is sunk into the object.
_SUNK = 0.003
# Times that a worker goes through the frames: a recording has a thousand and more, and is prepared once.
_PASSES = 8


def cases(settings: BenchmarkConfig) -> list[Case]:
    thing = meshes()[1]
    frames, faces, parts = _bodies(thing, settings.batch, settings.seed)
    annotator = ContactAnnotator(thing, frames[0], faces, parts, EPSILON)
    processes = settings.threads or machine_cores()
    parallel = Parallel(processes)
    plain, n = f"SciPy and trimesh ({len(frames)} frames)", len(frames)
    of = f"{n} frames of {len(parts)} × {len(thing.vertices)} vertices"
    return [
        Case(plain, lambda: [_plain(thing, vertices, faces) for vertices in frames], runs=2, frames=n),
        Case(f"annotator ({of})", lambda: [annotator(vertices) for vertices in frames], (plain,), frames=n),
        Case(
            f"annotators in {processes} processes",
            lambda: parallel(delayed(_annotated)(thing, frames, faces, parts) for _ in range(processes)),
            (plain,),
            frames=n * processes * _PASSES,
        ),
    ]


def _annotated(thing: Mesh, frames: list[np.ndarray], faces: np.ndarray, parts: np.ndarray) -> None:
    """What a worker of the preprocessing does with a recording's frames."""
    torch.set_num_threads(1)
    annotator = ContactAnnotator(thing, frames[0], faces, parts, EPSILON)
    for vertices in frames * _PASSES:
        annotator(vertices)


def _bodies(thing: Mesh, n: int, seed: int) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Vertices of a hand that touches the object and of a ball for the rest of the body; faces; parts."""
    generator = torch.Generator().manual_seed(seed)
    hand, parameters = hands(n, generator, "cpu")
    anatomy = Anatomy.of(hand)
    vertices = hand(parameters).vertices.numpy()
    surface, normals = thing.sample_surface(n, seed)
    tips = anatomy.tips[torch.randint(5, (n,), generator=generator)].numpy()
    vertices += (surface - _SUNK * normals - vertices[np.arange(n), tips])[:, None]
    rest = trimesh.creation.icosphere(5, 0.2)
    torso = rest.vertices + np.array([0, 0.6, 0])
    faces = np.concatenate([hand.faces.numpy(), rest.faces + vertices.shape[1]])
    parts = np.concatenate([np.array(RIGHT_HAND_PARTS)[anatomy.bone.numpy()], np.full(len(torso), PARTS["pelvis"])])
    return [np.concatenate([v, torso]).astype(np.float32) for v in vertices], faces, parts


def _plain(thing: Mesh, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Crossing edges of near triangles, and vertices near to triangles, found by trees of triangle centres."""
    body, other = vertices[faces].astype(np.float64), thing.triangles.astype(np.float64)
    low, high = thing.bounds
    near = ((body.min(1) <= high + EPSILON) & (body.max(1) >= low - EPSILON)).all(1)
    body = body[near]
    centres, other_centres = body.mean(1), other.mean(1)
    radius, other_radius = (
        np.linalg.norm(t - c[:, None], axis=-1).max() for t, c in ((body, centres), (other, other_centres))
    )
    tree, other_tree = cKDTree(centres), cKDTree(other_centres)
    pairs = tree.sparse_distance_matrix(other_tree, radius + other_radius, output_type="ndarray")
    a, b = body[pairs["i"]], other[pairs["j"]]
    for triangle, edges in ((a, b), (b, a)):
        for k in range(3):
            _crosses(edges[:, k], edges[:, (k + 1) % 3], triangle)
    for points, surface, around, reach in (
        (thing.vertices, body, tree, radius),
        (vertices[np.unique(faces[near])], other, other_tree, other_radius),
    ):
        pairs = cKDTree(points).sparse_distance_matrix(around, EPSILON + reach, output_type="ndarray")
        at = points[pairs["i"]].astype(np.float64)
        distance = np.linalg.norm(trimesh.triangles.closest_point(surface[pairs["j"]], at) - at, axis=1)
        np.minimum.at(np.full(len(points), np.inf), pairs["i"], distance)


def _crosses(start: np.ndarray, end: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(triangle, 1, 0)

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.einsum("ni,ni->n", np.cross(q - p, r - p), s - p) > 0

    through = [side(start, end, p, q) for p, q in ((a, b), (b, c), (c, a))]
    return (side(a, b, c, start) != side(a, b, c, end)) & (through[0] == through[1]) & (through[1] == through[2])
