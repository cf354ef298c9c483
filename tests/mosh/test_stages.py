"""Stages I and II find the truth of synthetic captures, whatever is wrong with these."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from grabnet.errors import UserError
from grabnet.mosh.attachment import Attachment
from grabnet.mosh.choosing import choose_frames
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.stage_one import StageOneConfig, stage_one
from grabnet.mosh.stage_two import StageTwoConfig, between, stage_two
from grabnet.mosh.synthesis import Flaws, in_one_ring, spoilt
from tests.mosh.conftest import Actor

PRIOR, RATE = PriorConfig(), 24.0


def solved(actor: Actor, seen: np.ndarray, **settings):
    attachment = Attachment(actor.body, actor.body.v_template, actor.truth, actor.latent)
    config = StageTwoConfig(**({"noise": 0.0012, "window": 16} | settings))
    prior = joint_prior(actor.body, PRIOR)
    return stage_two(attachment, torch.as_tensor(seen), RATE, prior, PRIOR, config, torch.as_tensor(actor.trunk))


def test_markers_sit_in_the_one_ring_of_their_vertices(actor):
    faces = actor.body.faces.numpy()
    for meant, real in zip(actor.layout.markers, actor.truth.markers, strict=True):
        assert (np.sort(faces, 1) == np.sort(real.vertices)).all(1).any() and meant.vertices[0] in real.vertices
    assert in_one_ring(actor.layout, faces, 0) == actor.truth != in_one_ring(actor.layout, faces, 1)


def test_flaws_are_as_large_as_asked_for():
    clean = np.random.default_rng(0).uniform(0, 1, (400, 30, 3))
    noisy = spoilt(clean, 120, Flaws(dropped=0), 1)
    assert (noisy - clean).std() == pytest.approx(0.001, rel=0.03)
    missing = np.isnan(spoilt(clean, 120, Flaws(noise=0), 1)[..., 0]).sum(1)
    assert set(missing) == set(range(6))
    bursts = np.isnan(spoilt(clean, 120, Flaws(noise=0, dropped=0, bursts=0.1), 1)[..., 0])
    assert 0.06 < bursts.mean() < 0.12 and (bursts[1:] & bursts[:-1]).sum() > 0.9 * bursts.sum()
    swapped = spoilt(clean, 120, Flaws(noise=0, dropped=0, swapped=0.04), 1)
    changed = (swapped != clean).any(-1)
    assert 0.03 < changed.mean() <= 0.04
    assert sorted(swapped[changed][:, 0]) == sorted(clean[changed][:, 0]), "the same places under other labels"
    ghosts = (spoilt(clean, 120, Flaws(noise=0, dropped=0, ghosts=0.05), 1) != clean).any(-1)
    assert 0.04 < ghosts.mean() < 0.06


def test_stage_one_finds_the_places_though_no_frame_has_all_markers(actor):
    seen = spoilt(actor.markers, 120, Flaws(), 0)
    seen[np.arange(24), np.arange(24)] = np.nan
    frames = choose_frames(seen, actor.guess, actor.trunk, 10, "f")
    assert len(set(frames.tolist())) == 10 and np.isnan(seen[frames][..., 0]).any(1).all()
    config = StageOneConfig(annealing=(1.0, 1.0, 1.0), iterations=10)
    found = stage_one(actor.body, actor.body.v_template, actor.layout, seen[frames], config, PRIOR)
    off = 1e3 * (found.latent - actor.latent).norm(dim=-1)
    before = 1e3 * (torch.as_tensor(actor.guess) - actor.latent).norm(dim=-1)
    assert off.mean() < 2.0 < 0.4 * before.mean()
    assert found.residuals.nanmean() < 0.002


def test_stage_one_finds_the_shape_where_no_scan_gives_it(actor):
    betas = torch.tensor([1.0, -1.0, 0.5])
    template = actor.body.shaped(betas)
    other = replace_template(actor, template)
    config = StageOneConfig(betas=3, annealing=(1.0, 1.0), iterations=10)
    found = stage_one(actor.body, actor.body.v_template, actor.layout, other[::4], config, PRIOR)
    unshaped = (template - actor.body.v_template).norm(dim=-1).mean()
    assert (found.v_template - template).norm(dim=-1).mean() < 0.25 * unshaped
    assert found.betas[0] == pytest.approx(1.0, abs=0.25)


def replace_template(actor: Actor, template: torch.Tensor) -> np.ndarray:
    """The actor's markers, had they another shape."""
    from grabnet.body.anatomy import vertex_normals
    from grabnet.mosh.placing import marker_positions

    vertices = actor.body(actor.parameters, template).vertices
    return marker_positions(
        actor.truth, vertices.double().numpy(), vertex_normals(vertices, actor.body.faces).double().numpy()
    )


def test_stage_two_finds_the_body(actor):
    seen = spoilt(actor.markers, 120, Flaws(), 0)
    off = actor.v2v(solved(actor, seen))
    assert off.mean() < 1.6 and off.max() < 3.0


def test_swapped_labels_and_ghosts_bend_nothing(actor):
    base = spoilt(actor.markers, 120, Flaws(dropped=0), 0)
    clean = actor.v2v(solved(actor, base)).mean()
    worse = base.copy()
    index = actor.layout.labels.index
    for frame, (a, b) in enumerate((("LIND3", "LMID3"), ("RPIN2", "RRIN2"), ("LKNE", "RKNE"), ("NOSE", "ULIP"))):
        now = slice(5 * frame, 5 * frame + 3)
        worse[now, [index(a), index(b)]] = worse[now, [index(b), index(a)]]
    worse[7, index("RTHM3")] += 0.1
    assert actor.v2v(solved(actor, worse)).mean() < 1.1 * clean


def test_a_hidden_hand_stays_where_it_was_going(actor):
    seen = spoilt(actor.markers, 120, Flaws(dropped=0), 0)
    hidden = [k for k, label in enumerate(actor.layout.labels) if label[1:4] in ("IND", "MID", "RIN", "PIN")]
    seen[10:14, hidden] = np.nan
    off = actor.v2v(solved(actor, seen))
    assert off[10:14].max() < 2 * off.mean() + 2


def test_single_and_empty_frames(actor):
    seen = spoilt(actor.markers, 120, Flaws(dropped=0), 0)
    assert actor.v2v(solved(actor, seen[:1]))[0] < 2.5
    seen[8] = np.nan
    pose = solved(actor, seen)
    assert all(value.isfinite().all() for value in pose)
    with pytest.raises(UserError, match="no frame shows three markers"):
        solved(actor, np.full_like(seen, np.nan))


def test_a_subject_that_is_never_seen_enough_is_refused(actor):
    seen = actor.markers.copy()
    seen[:, 40:] = np.nan
    with pytest.raises(UserError, match="f: no frame shows enough of the subject, 40 of 99 markers at most"):
        choose_frames(seen, actor.guess, actor.trunk, 12, "f")


def test_poses_between_others(actor):
    attachment = Attachment(actor.body, actor.body.v_template, actor.truth, actor.latent, dtype=torch.float64)
    pose = attachment.neutral(2)
    pose.transl[1] = 1.0
    pose.rotations[1, 3] = torch.tensor([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])
    found = between(pose, torch.tensor([2, 6]), torch.arange(8))
    assert found.transl[:, 0].tolist() == [0, 0, 0, 0.25, 0.5, 0.75, 1, 1]
    angle = torch.atan2(found.rotations[4, 3, 1, 0], found.rotations[4, 3, 0, 0])
    assert angle.item() == pytest.approx(np.pi / 4)


def test_settings_out_of_range_are_refused():
    for make in (lambda: StageOneConfig(frames=0), lambda: StageTwoConfig(noise=0), lambda: PriorConfig(twist=-1)):
        with pytest.raises(UserError, match="must be"):
            make()
    with pytest.raises(UserError, match="must be at least 0"):
        replace(Flaws(), noise=-1)
