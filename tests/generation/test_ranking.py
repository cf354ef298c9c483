"""The choice among candidates, against the same choice written out in plain loops."""

from __future__ import annotations

import math

import pytest
import torch

from grabnet.errors import UserError
from grabnet.generation.ranking import RankingConfig, choose, pool_sizes

CONFIG = RankingConfig()


def some(n: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return 20 * torch.rand(n, generator=generator), 0.02 * torch.randn(n, 21, 3, generator=generator)


def by_hand(score: list[float], keypoints: torch.Tensor, pools: list[int], config: RankingConfig) -> list[int]:
    """The same choice, each distance computed when it is needed."""
    chosen: list[int] = []
    for pool in pools:
        costs = {}
        for i in set(range(pool)) - set(chosen):
            nearest = min(((keypoints[i] - keypoints[j]).norm(dim=1).mean().item() for j in chosen), default=math.inf)
            is_last = not math.isfinite(score[i]), nearest < config.distinct
            costs[i] = (*is_last, score[i] + config.variety * math.exp(-((nearest / config.likeness) ** 2)))
        chosen.append(min(costs, key=costs.get))
    return chosen


@pytest.mark.parametrize("variety", [0.0, 10.0, 100.0])
def test_choice_is_that_of_plain_loops(variety):
    score, keypoints = some(48, seed=1)
    config, pools = RankingConfig(variety=variety), pool_sizes(15, 3, 16)
    assert choose(score, keypoints, pools, config).index.tolist() == by_hand(
        score.tolist(), keypoints, pools.tolist(), config
    )


def test_pools_grow_by_blocks_and_do_not_depend_on_n():
    assert pool_sizes(9, 4, 16).tolist() == [16] * 4 + [32] * 4 + [48]
    assert pool_sizes(3, 4, 16).tolist() == pool_sizes(9, 4, 16)[:3].tolist()


def test_fewer_grasps_are_the_first_of_more():
    score, keypoints = some(256, seed=2)
    many = choose(score, keypoints, pool_sizes(60, 4, 32), CONFIG)
    few = choose(score[:96], keypoints[:96], pool_sizes(24, 4, 32), CONFIG)
    assert many.index[:24].tolist() == few.index.tolist()
    torch.testing.assert_close(many.nearest[:24], few.nearest)


def test_copies_come_last_however_good():
    score, keypoints = some(20, seed=3)
    keypoints[10:] = keypoints[:10] + 1e-3
    score[10:] = -5.0
    kept = choose(score, keypoints, torch.full((20,), 20), CONFIG)
    assert sorted(kept.index.tolist()) == list(range(20))
    assert sorted(i % 10 for i in kept.index[:10].tolist()) == list(range(10))
    assert (kept.nearest[1:10] > CONFIG.distinct).all()
    assert (kept.nearest[10:] < CONFIG.distinct).all()


def test_nearest_is_the_distance_to_those_chosen_before():
    score, keypoints = some(24, seed=4)
    kept = choose(score, keypoints, torch.full((12,), 24), CONFIG)
    assert kept.nearest[0] == math.inf
    for i in range(1, 12):
        before = keypoints[kept.index[:i]]
        expected = (before - keypoints[kept.index[i]]).norm(dim=-1).mean(-1).amin()
        torch.testing.assert_close(kept.nearest[i], expected.double())


def test_what_is_not_a_number_is_not_kept_while_others_are_left():
    score, keypoints = some(12, seed=5)
    score[[0, 4]] = math.nan
    score[7] = math.inf
    keypoints[4] = math.nan
    kept = choose(score, keypoints, torch.full((9,), 12), CONFIG).index.tolist()
    assert sorted(kept) == [1, 2, 3, 5, 6, 8, 9, 10, 11]


@pytest.mark.parametrize("wrong", [{"variety": -1.0}, {"likeness": 0.0}, {"distinct": math.nan}])
def test_a_value_out_of_range_is_refused(wrong):
    with pytest.raises(UserError, match=next(iter(wrong))):
        RankingConfig(**wrong)
