"""Whether a body model built again is the one that is shipped."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.io.npz import read_npz

TOLERANCE = 1e-4  # metres, or shares of weight: what another machine's arithmetic may change


def compare_models(rebuilt: str | Path, shipped: str | Path) -> tuple[str, float]:
    """Compare two `.npz` files array by array.

    Returns:
        the name of the array that differs most, and by how much.

    Raises:
        UserError: arrays differ in name or shape, whole numbers or text at all, or others by more than `TOLERANCE`.
    """
    new, old = read_npz(rebuilt), read_npz(shipped)
    if new.keys() != old.keys():
        raise UserError(f"{shipped} has the arrays {', '.join(sorted(old))}; built again: {', '.join(sorted(new))}.")
    differences = {name: _difference(np.asarray(new[name]), np.asarray(old[name])) for name in new}
    name = max(differences, key=differences.__getitem__)
    if differences[name] > TOLERANCE:
        raise UserError(f"{shipped} is not what is built now: {name} is up to {differences[name]:.2g} off.")
    return name, differences[name]


def _difference(new: np.ndarray, old: np.ndarray) -> float:
    if new.shape != old.shape:
        return np.inf
    if not np.issubdtype(new.dtype, np.floating):
        return 0.0 if np.array_equal(new, old) else np.inf
    return float(np.abs(new - old).max(initial=0))
