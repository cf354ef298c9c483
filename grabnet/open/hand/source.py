"""Right hands of random adults, from the MakeHuman body that anny carries (assets CC0, code Apache-2.0)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from grabnet.errors import UserError

BONES = (
    "lowerarm01",
    "lowerarm02",
    "wrist",
    *(f"metacarpal{k}" for k in (1, 2, 3, 4)),
    *(f"finger{finger}-{k}" for finger in (1, 2, 3, 4, 5) for k in (1, 2, 3)),
)


@dataclass(frozen=True)
class AdultHands:
    """N hands as modelled: slightly curled, at the end of a hanging arm. Metres, z up, body frame.

    vertices (N, V, 3); faces (F, 3); heads and tails (N, len(BONES), 3) of the `BONES`; weights (V, len(BONES)).
    """

    vertices: np.ndarray
    faces: np.ndarray
    heads: np.ndarray
    tails: np.ndarray
    weights: np.ndarray


def sample_adults(n: int, seed: int, forearm: float = 0.015) -> AdultHands:
    """Hands of `n` random adults, cut along a ring of edges at least `forearm` metres behind the wrist joint.

    Raises:
        UserError: anny isn't installed.
    """
    try:
        import anny
    except ImportError:
        raise UserError(
            'The open hand is made from anny, which is missing: pip install "grabnet[open-hand]".'
        ) from None
    import torch

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # The rig and topology of MakeHuman itself; anny's smplx and smpl topologies stand under other licences.
        body = anny.Anny(
            rig="makehuman",
            topology="anny",
            local_changes="default",
            phenotypes="all",
            phenotype_blendshapes="original",
            skinning_method="lbs",
        )
        hand = anny.Anny(rig="anny-hand.R", topology="hand.R")
    rng = np.random.default_rng(seed)
    vertices, heads, tails = [], [], []
    phenotype, changes = _adults(n, rng), _hand_changes(n, rng)
    with torch.no_grad():
        for start in range(0, n, 50):  # 50 bodies at once: 0.2 GB
            chunk = slice(start, start + 50)
            coefficients = body.get_phenotype_blendshape_coefficients(
                **{name: torch.as_tensor(value[chunk]) for name, value in phenotype.items()},
                local_changes={name: torch.as_tensor(value[chunk]) for name, value in changes.items()},
            )
            rest = body.get_rest_model(coefficients)
            for store, key in ((vertices, "rest_vertices"), (heads, "rest_bone_heads"), (tails, "rest_bone_tails")):
                store.append(rest[key].numpy())
    vertices, heads, tails = (np.concatenate(x) for x in (vertices, heads, tails))

    bones = [body.bone_labels.index(f"{name}.R") for name in BONES]
    wrist, middle = (heads[:, body.bone_labels.index(name)].mean(0) for name in ("wrist.R", "finger3-1.R"))
    backward = (wrist - middle) / np.linalg.norm(wrist - middle)
    of_base_mesh = {int(base): own for own, base in enumerate(body.base_mesh_vertex_indices)}
    seed_vertices = [of_base_mesh[int(base)] for base in hand.base_mesh_vertex_indices]
    kept, faces = _grow(
        body.faces.numpy(), seed_vertices, lambda loop: (vertices[:, loop].mean((0, 1)) - wrist) @ backward > forearm
    )
    weights = body.dense_vertex_bone_weights.numpy()[kept][:, bones]
    return AdultHands(
        vertices[:, kept], faces, heads[:, bones], tails[:, bones], weights / weights.sum(1, keepdims=True)
    )


def _adults(n: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Phenotypes: both sexes, ages from about 25 to 80 years, every other trait spread about the middle."""
    phenotype = {"gender": rng.uniform(0, 1, n), "age": rng.uniform(0.6, 0.95, n)}
    for name, mean, deviation in (
        ("muscle", 0.5, 0.2), ("weight", 0.5, 0.2), ("height", 0.45, 0.08), ("proportions", 0.5, 0.2),
    ):  # fmt: skip
        phenotype[name] = np.clip(rng.normal(mean, deviation, n), 0, 1)
    origins = rng.dirichlet([1, 1, 1], n).T
    return phenotype | dict(zip(("african", "asian", "caucasian"), origins, strict=True))


def _hand_changes(n: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    deviations = {"fingers-length": 0.35, "scale": 0.08, "fingers-diameter": 0.35, "fingers-distance": 0.35}
    return {f"r-hand-{name}-incr": np.clip(rng.normal(0, d, n), -1, 1) for name, d in deviations.items()}


def _grow(faces: np.ndarray, start: list[int], far_enough) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and renumbered faces of the patch around `start`, grown by rings until its boundary is far enough."""
    inside = np.zeros(faces.max() + 1, bool)
    inside[start] = True
    while True:
        patch = faces[inside[faces].all(1)]
        edges = np.sort(patch[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1)
        unique, count = np.unique(edges, axis=0, return_counts=True)
        if far_enough(np.unique(unique[count == 1])):
            kept = np.unique(patch)
            return kept, np.searchsorted(kept, patch)
        inside[faces[inside[faces].any(1)]] = True
