"""Made-up files of MANO's and SMPL-X's exact shapes: random, so that no array can be mistaken for another."""

from __future__ import annotations

import numpy as np
import pytest

BODY_PARENTS = [
    *(2**32 - 1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15),
    *(parent for wrist, first in ((20, 25), (21, 40)) for k in range(0, 15, 3)
      for parent in (wrist, first + k, first + k + 1)),
]  # fmt: skip
PARENTS = [2**32 - 1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14]


@pytest.fixture(scope="session")
def random_mano() -> dict[str, np.ndarray]:
    """Arrays of a right hand in MANO's schema."""
    rng = np.random.default_rng(0)
    weights = rng.random((778, 16)) ** 4
    regressor = rng.random((16, 778)) ** 8
    return {
        "v_template": rng.normal(0, 0.05, (778, 3)),
        "shapedirs": rng.normal(0, 0.003, (778, 3, 10)),
        "posedirs": rng.normal(0, 0.002, (778, 3, 135)),
        "J_regressor": regressor / regressor.sum(1, keepdims=True),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.array([PARENTS, range(16)], np.int64),
        "f": rng.permuted(np.tile(np.arange(778), (1538, 1)), axis=1)[:, :3].astype(np.uint32),
        "hands_components": np.linalg.qr(rng.normal(size=(45, 45)))[0],
        "hands_mean": rng.normal(0, 0.2, 45),
    }


@pytest.fixture(scope="session")
def random_smplx() -> dict[str, np.ndarray]:
    """Arrays of a whole body in SMPL-X's schema, with ten shape and ten expression directions."""
    rng = np.random.default_rng(1)

    def normal(size: float, *shape: int) -> np.ndarray:
        return (size * rng.standard_normal(shape, np.float32)).astype(np.float32)

    weights = rng.random((10475, 55)) ** 8
    regressor = rng.random((55, 10475)) ** 16
    return {
        "v_template": normal(0.2, 10475, 3),
        "shapedirs": normal(0.005, 10475, 3, 20),
        "posedirs": normal(0.001, 10475, 3, 486),
        "J_regressor": (regressor / regressor.sum(1, keepdims=True)).astype(np.float32),
        "weights": (weights / weights.sum(1, keepdims=True)).astype(np.float32),
        "kintree_table": np.array([BODY_PARENTS, range(55)], np.int64),
        "f": rng.integers(0, 10475, (20908, 3)).astype(np.uint32),
        "hands_componentsl": np.linalg.qr(rng.normal(size=(45, 45)))[0].astype(np.float32),
        "hands_componentsr": np.linalg.qr(rng.normal(size=(45, 45)))[0].astype(np.float32),
        "hands_meanl": normal(0.2, 45),
        "hands_meanr": normal(0.2, 45),
        "lmk_faces_idx": np.arange(51),
        "lmk_bary_coords": np.full((51, 3), 1 / 3, np.float32),
    }
