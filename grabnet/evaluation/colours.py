"""Colours of what is touched."""

from __future__ import annotations

import numpy as np

TOUCHED = (0.86, 0.2, 0.15)


def blended(base: tuple[float, float, float], share: np.ndarray) -> np.ndarray:
    """Return (V, 3) colours in [0, 1] from `base` where share (V,) is 0 to red where it is 1."""
    share = np.asarray(share, float)[:, None]
    return (1 - share) * np.array(base) + share * np.array(TOUCHED)
