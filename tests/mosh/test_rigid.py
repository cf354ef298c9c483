"""Objects by their markers, against scipy and against motions that are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from grabnet.errors import UserError
from grabnet.mosh.layouts import object_layout
from grabnet.mosh.rigid import DegenerateMarkersError, align, follow, model_of

MOCAP = Path(__file__).parents[3] / "shared/mocap"


def motion(frames: int = 60) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Markers (8, 3), their motion (T, 3, 3) and (T, 3), and where they are seen."""
    time = np.linspace(0, 1, frames)
    turn = np.stack([np.sin(2 * time), time, 0.5 * time], 1)
    rotations = torch.as_tensor(Rotation.from_rotvec(turn).as_matrix())
    transl = torch.as_tensor(np.stack([time, np.cos(time), 0 * time], 1))
    markers = torch.as_tensor(np.random.default_rng(0).uniform(-0.05, 0.05, (8, 3)))
    return markers, rotations, transl, markers @ rotations.mT + transl.unsqueeze(1)


def test_alignment_agrees_with_scipy():
    source, target = torch.randn(2, 8, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    weights = torch.linspace(0.1, 1, 8).double()
    middles = [(weights.unsqueeze(1) * x).sum(0) / weights.sum() for x in (source, target)]
    expected, _ = Rotation.align_vectors(target - middles[1], source - middles[0], weights=weights)
    rotation, transl = align(source, target, weights)
    torch.testing.assert_close(rotation, torch.as_tensor(expected.as_matrix()))
    torch.testing.assert_close(transl, middles[1] - rotation @ middles[0])


def test_outliers_and_missing_markers_do_not_move_the_object():
    markers, rotations, transl, seen = motion()
    seen[3, :5] = torch.nan  # three are left
    seen[5:9, [0, 4]] = seen[5:9, [4, 0]]  # swapped
    seen[20, 6] += 0.1  # a ghost
    found = follow(markers, seen)
    torch.testing.assert_close(found.rotations, rotations)
    torch.testing.assert_close(found.transl, transl)
    assert found.solved.all() and found.residuals[20, 6] > 0.09


def test_short_gaps_are_interpolated_and_longer_ones_marked():
    markers, _, transl, seen = motion()
    seen[10:14], seen[30:50], seen[59, 2:] = torch.nan, torch.nan, torch.nan
    found = follow(markers, seen, max_gap=4)
    assert (~found.solved).nonzero().squeeze(1).tolist() == [*range(10, 14), *range(30, 50), 59]
    assert found.filled.nonzero().squeeze(1).tolist() == [*range(10, 14)]
    assert (found.transl[10:14] - transl[10:14]).norm(dim=1).max() < 1e-3
    torch.testing.assert_close(found.rotations[59], found.rotations[58])


def test_averaging_over_time_takes_noise_away_and_leaves_the_motion():
    markers, rotations, transl, seen = motion(240)
    noisy = seen + 1e-3 * torch.randn(seen.shape, generator=torch.Generator().manual_seed(0), dtype=seen.dtype)
    off = [(follow(markers, noisy, smooth=n).transl - transl)[10:-10].norm(dim=1).mean() for n in (0, 10)]
    assert off[1] < 0.5 * off[0]
    clean = follow(markers, seen, smooth=10)
    assert (clean.rotations - rotations).abs().max() < 1e-3
    assert (clean.transl - transl).norm(dim=1).max() < 1e-3


def test_frames_of_which_nothing_is_known_pull_no_others():
    markers, _, transl, seen = motion(30)
    seen[:3], seen[27:] = torch.nan, torch.nan
    found = follow(markers, seen, max_gap=12, smooth=4)
    assert not found.filled.any(), "held at the ends, however short the recording"
    assert (found.transl - transl)[3:27].norm(dim=1).max() < 1e-3 and found.residuals[3:27].max() < 1e-3


def test_what_cannot_be_followed_is_refused():
    markers, _, _, seen = motion()
    with pytest.raises(DegenerateMarkersError, match="no frame shows 3"):
        follow(markers, torch.full_like(seen, torch.nan))
    line = torch.linspace(0, 1, 8).double().unsqueeze(1) * torch.ones(3).double()
    with pytest.raises(DegenerateMarkersError, match="not on one line"):
        follow(line, line.expand(4, -1, -1))
    with pytest.raises(UserError, match="The markers of stick lie on one line"):
        object_layout("stick", ["a", "b", "c"], np.outer([0, 1, 2.0], [1, 1, 0]))
    with pytest.raises(UserError, match="stick has 2 markers"):
        object_layout("stick", ["a", "b"], np.eye(3)[:2])


@pytest.mark.skipif(not MOCAP.exists(), reason="the real recordings are not here")
def test_a_real_box_without_a_model_stays_rigid():
    from grabnet.mosh.captures import read_capture

    seen = torch.as_tensor(read_capture(MOCAP / "box_and_subject.c3d").under("boite").positions)
    found = follow(model_of(seen), seen)
    assert found.solved.all() and 1.5e-4 < found.residuals.nanmean() < 2.2e-4  # 0.18 mm measured elsewhere (ref. 12)
