"""Random adults from the MakeHuman body that anny carries (assets CC0, code Apache-2.0)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from grabnet.errors import UserError


@dataclass(frozen=True)
class AdultBodies:
    """N bodies as modelled, arms hanging at an angle. Metres, z up, facing −y.

    vertices (N, V, 3); faces (F, 3); heads and tails (N, B, 3) of the `bones`, each with its parent's number (B,), -1
    for the root; weights (V, B); gender (N,) from 0, a man, to 1, a woman; right_hand: vertices of anny's right hand.
    """

    vertices: np.ndarray
    faces: np.ndarray
    heads: np.ndarray
    tails: np.ndarray
    bones: list[str]
    parents: list[int]
    weights: np.ndarray
    gender: np.ndarray
    right_hand: list[int]


def sample_bodies(n: int, seed: int) -> AdultBodies:
    """Bodies of `n` random adults.

    Raises:
        UserError: anny isn't installed.
    """
    try:
        import anny
    except ImportError:
        raise UserError(
            "The open hand and body are made from anny, which is missing: pip install -e '.[open-hand]'."
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
    of_base_mesh = {int(base): own for own, base in enumerate(body.base_mesh_vertex_indices)}
    return AdultBodies(
        np.concatenate(vertices),
        body.faces.numpy(),
        np.concatenate(heads),
        np.concatenate(tails),
        list(body.bone_labels),
        [int(parent) for parent in body.bone_parents],
        body.dense_vertex_bone_weights.numpy(),
        phenotype["gender"],
        [of_base_mesh[int(base)] for base in hand.base_mesh_vertex_indices],
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
    changes = {name: np.clip(rng.normal(0, d, n), -1, 1) for name, d in deviations.items()}
    return {f"{side}-hand-{name}-incr": change for side in "rl" for name, change in changes.items()}
