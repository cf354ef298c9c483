"""Numbers as people read them."""

from __future__ import annotations

import math


def digits(value: float) -> str:
    """Return a number with three significant digits, and at most three after the point."""
    if not math.isfinite(value):
        return "–"
    size = abs(value)
    if size < 0.0005:
        return "0"
    return f"{value:.{0 if size >= 99.95 else 1 if size >= 9.995 else 2 if size >= 0.0995 else 3}f}"
