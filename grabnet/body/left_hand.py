"""Shapes of left hands. In the published MANO_LEFT the x coordinates of `shapedirs` have the right hand's sign, though
its template is a mirror image: a hand that grows in y and z becomes narrower in x (ref. 1)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grabnet.body.loading import Shapes, read_model
from grabnet.errors import UserError

# Mean distance in metres at which a template still counts as the mirror image of another.
_MIRRORED = 2e-3
# Correlation of displacement and place from which a shape direction counts as growth; the open hand's is 0.96.
_GROWTH = 0.6


def unmirrored(path: str | Path, model: dict[str, np.ndarray], shapes: Shapes) -> np.ndarray:
    """(S,) bool: shape directions of a left hand whose x has the wrong sign.

    Found by the right hand whose file lies beside, else by the first direction, which is growth: all are taken for
    wrong where it goes another way in x than in y and z.

    Args:
        path: of the left hand, LEFT in its name.
        model: its arrays: v_template (V, 3) and shapedirs (V, 3, S).
        shapes: of both hands' arrays; see `read_model`.
    """
    template, directions = model["v_template"].astype(np.float64), model["shapedirs"].astype(np.float64)
    right = _right_hand(Path(path), shapes)
    if right is not None and right["shapedirs"].shape == directions.shape:
        mirrored = right["v_template"] * [-1, 1, 1]
        if np.linalg.norm(template - mirrored, axis=1).mean() < _MIRRORED:
            left_x, right_x = directions[:, 0], right["shapedirs"][:, 0]
            return np.abs(left_x - right_x).sum(0) < np.abs(left_x + right_x).sum(0)
    place, moved = (array - array.mean(0) for array in (template, directions[:, :, 0]))
    growth = [_correlation(place[:, axes], moved[:, axes]) for axes in ([0], [1, 2])]
    grows_askew = np.sign(growth[0]) != np.sign(growth[1]) and min(map(abs, growth)) > _GROWTH
    return np.full(directions.shape[-1], grows_askew)


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float((a * b).sum() / max(np.sqrt((a**2).sum() * (b**2).sum()), 1e-12))


def _right_hand(path: Path, shapes: Shapes) -> dict[str, np.ndarray] | None:
    """The model in the file called like `path`, but RIGHT; None where there is none that can be read."""
    for old, new in (("LEFT", "RIGHT"), ("left", "right"), ("Left", "Right")):
        beside = path.with_name(path.name.replace(old, new))
        if beside != path and beside.is_file():
            try:
                return read_model(beside, shapes, "MANO")
            except UserError:
                return None
    return None
