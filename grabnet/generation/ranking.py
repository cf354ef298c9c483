"""Which candidates are kept: the best ones that are not like one kept already."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from grabnet.cli.checks import Batch, Positive, Weight, in_range
from grabnet.cli.progress import track

# What the numbers of a report are, kept beside them.
DEFINITIONS = {
    "candidate": "number of the candidate that was kept",
    "nearest_mm": "mean distance of joints and fingertips to those of the most similar grasp kept before",
    "score": "what is wrong with the grasp, counted in millimetres; candidates with less are kept: depth and through "
    "beyond what skin yields, bone (object in the core of a finger), crossing (fingers in each other), joints (beyond "
    "their limits), table (hand below it), unheld (thumb or fingers do not touch), force (share of the object's weight "
    "that contacts cannot bear, from six directions), fingers (below 0, for those that touch)",
}
# A score that comes after all others.
_LAST = 1e30


@dataclass(frozen=True)
class RankingConfig:
    """How candidates are chosen; `configs/shared/ranking/default.yaml` explains the values.

    Raises:
        UserError: a value out of range.
    """

    pool: Batch = 256
    variety: Weight = 3.0
    likeness: Positive = 0.02
    distinct: Weight = 0.005
    depth: Weight = 1.0
    depth_free: Weight = 1.0
    through: Weight = 4.0
    through_free: Weight = 2.0
    bone: Weight = 10.0
    crossing: Weight = 1.0
    joint: Weight = 0.2
    table: Weight = 2.0
    unheld: Weight = 20.0
    force: Weight = 40.0
    finger: Weight = 0.8

    def __post_init__(self):
        in_range(self, "ranking.")


class Kept(NamedTuple):
    """N candidates in the order in which they were chosen: their numbers (N,), and the mean distance (N,) in metres
    of each one's keypoints to those of the most similar one chosen before it; infinite for the first."""

    index: Tensor
    nearest: Tensor


@dataclass(frozen=True, eq=False)
class Ranked:
    """Why N grasps were kept.

    Attributes:
        kept: numbers and distinctness.
        parts: (N,) parts of the score, by name; lower is better.
    """

    kept: Kept
    parts: dict[str, Tensor]

    def first(self, n: int) -> Ranked:
        """The first n of them."""
        return Ranked(Kept(*(x[:n] for x in self.kept)), {name: values[:n] for name, values in self.parts.items()})

    def report(self) -> list[dict[str, Any]]:
        """One record per grasp, ready for JSON: candidate, parts of the score, nearest_mm (null for the first)."""
        nearest = [None if d == float("inf") else round(1000 * d, 2) for d in self.kept.nearest.tolist()]
        parts = [dict(zip(self.parts, row, strict=True)) for row in torch.stack([*self.parts.values()], 1).tolist()]
        return [
            {"candidate": i, "score": {k: round(v, 3) for k, v in score.items()}, "nearest_mm": d}
            for i, score, d in zip(self.kept.index.tolist(), parts, nearest, strict=True)
        ]


def pool_sizes(n: int, candidates: int, block: int) -> Tensor:
    """(n,) candidates that grasp i is chosen from: the first (i + 1) · `candidates`, up to a whole number of blocks.

    The size does not depend on n, and neither does the choice.
    """
    needed = (torch.arange(n) + 1) * candidates
    return -(-needed // block) * block


def choose(score: Tensor, keypoints: Tensor, pools: Tensor, config: RankingConfig) -> Kept:
    """Choose grasps one after the other, greedily.

    Each is the candidate of its pool, not chosen before, with the lowest score + `variety` · exp(−(d / `likeness`)²), d
    being the mean distance of its keypoints to those of the most similar one chosen before. One with d below `distinct`
    is a duplicate: it is chosen only where the pool has nothing else left, as is one whose score is not finite.

    Args:
        score: (M,) of the candidates, lower is better.
        keypoints: (M, K, 3) metres, in one frame of the object.
        pools: (n,) sizes, each grasp's pool being so many candidates from the first on; not decreasing.
        config: of the choice.
    """
    score = torch.where(score.isfinite(), score.double(), _LAST)
    nearest = torch.full_like(score, torch.inf)
    index, apart = [], []
    keypoints = keypoints.float()
    for pool in track(pools.tolist(), "Choosing grasps"):
        alike = config.variety * (-(nearest[:pool] / config.likeness).square()).exp()
        best = int((score[:pool] + torch.where(nearest[:pool] < config.distinct, _LAST, alike)).argmin())
        index.append(best)
        apart.append(nearest[best].clone())
        score[best] = torch.inf
        distance = (keypoints - keypoints[best]).norm(dim=-1).mean(-1).double().nan_to_num(torch.inf)
        nearest = torch.minimum(nearest, distance)
    return Kept(torch.tensor(index), torch.stack(apart))
