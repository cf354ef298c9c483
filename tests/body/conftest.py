"""A made-up file of MANO's exact shapes: random, so that no array's role can be mistaken for another's."""

from __future__ import annotations

import numpy as np
import pytest

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
