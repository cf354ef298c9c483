"""Which frames show best where markers sit: many markers seen, poses that differ (ref. 5)."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.errors import UserError
from grabnet.mosh.rigid import align

_CANDIDATES = 2000  # frames looked at, evenly spread
# How many times as far apart as on the body at rest the trunk's markers may lie: children, and shapes not yet known.
_SIZES = (0.4, 2.0)


def choose_frames(positions: np.ndarray, resting: np.ndarray, trunk: np.ndarray, n: int, where: object) -> np.ndarray:
    """Frames for Stage I, in order of choice: each shows what those before show least, or in another pose.

    A frame counts by how many markers it has; no frame need have all. Poses are compared after the trunk has been laid
    over the trunk at rest.

    Args:
        positions: (T, M, 3) markers, metres; NaN where missing.
        resting: (M, 3) about where they are on the body at rest.
        trunk: (M,) which are on the trunk.
        n: frames to choose, fewer where there are fewer.
        where: the capture, for messages.

    Raises:
        UserError: no frame shows three markers of the trunk and half of all; as `refuse_other_size`.
    """
    refuse_other_size(positions, resting, trunk, where)
    seen = np.isfinite(positions[..., 0])
    able = ((seen & trunk).sum(1) >= 3) & (seen.mean(1) >= 0.5)
    if not able.any():
        best = int(seen.sum(1).max())
        raise UserError(
            f"{where}: no frame shows enough of the subject, {best} of {seen.shape[1]} markers at most; half of them "
            "and three of the trunk's are needed to find out where they sit."
        )
    candidates = able.nonzero()[0]
    candidates = candidates[:: max(1, len(candidates) // _CANDIDATES)]
    there = seen[candidates]
    rotation, translation = align(
        torch.as_tensor(positions[candidates]), torch.as_tensor(resting).expand(len(candidates), -1, -1),
        torch.as_tensor(there & trunk).double(),
    )  # fmt: skip
    laid = torch.as_tensor(positions[candidates]) @ rotation.mT + translation.unsqueeze(1)
    laid = np.where(there[..., None], laid.numpy(), np.nan)
    usable = np.isfinite(laid[:, trunk][..., 0]).any(1)
    candidates, laid, there = candidates[usable], laid[usable], there[usable]
    middle = np.nansum(laid, 0) / np.maximum(1, there.sum(0))[:, None]  # 0 of markers that none of the frames shows
    laid = np.where(there[..., None], laid, middle)
    # A swapped label or a ghost is far from everything: no frame is chosen for the sake of one.
    laid = np.clip(laid, *np.nanquantile(laid, (0.02, 0.98), axis=0))
    chosen = [int(there.sum(1).argmax())]
    distance = np.full(len(laid), np.inf)
    shown = there[chosen[0]].astype(float)
    while len(chosen) < min(n, len(candidates)):
        off = np.linalg.norm(laid - laid[chosen[-1]], axis=-1).mean(1)
        distance = np.minimum(distance, off)
        worth = there.mean(1) ** 2 * (distance + 1e-4) * (1 + (there / (1 + shown)).mean(1))
        worth[chosen] = -1
        chosen.append(int(worth.argmax()))
        shown += there[chosen[-1]]
    return candidates[chosen]


def refuse_other_size(positions: np.ndarray, resting: np.ndarray, trunk: np.ndarray, where: object) -> None:
    """Refuse markers that are in another unit than they claim; arguments as of `choose_frames`.

    Raises:
        UserError: the trunk's markers lie much closer together or further apart than those of a body.
    """
    there = trunk & np.isfinite(positions[..., 0])
    some = (there.sum(1) >= 3).nonzero()[0]
    some = some[:: max(1, len(some) // 50)]
    if not len(some):
        return
    ratio = float(np.median([_width(positions[t, there[t]]) / _width(resting[there[t]]) for t in some]))
    if not _SIZES[0] <= ratio <= _SIZES[1]:
        raise UserError(
            f"{where}: the markers of the trunk lie {ratio:.2g} times as far apart as on a body: give the right "
            "reading.unit=mm, cm or m."
        )


def _width(places: np.ndarray) -> float:
    """Of places (N, 3): root mean square distance to their middle."""
    return float(np.sqrt(((places - places.mean(0)) ** 2).sum(1).mean()))
