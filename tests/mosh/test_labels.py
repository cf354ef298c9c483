"""Wrong labels, hidden markers, long recordings: what Stage II makes of them, and the parts that see to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from grabnet.body.skeleton import JOINTS
from grabnet.errors import UserError
from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.doubting import undoubted
from grabnet.mosh.layouts import Layout
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.relabelling import relabelled
from grabnet.mosh.so3 import exp, log
from grabnet.mosh.stage_one import StageOneConfig, stage_one
from grabnet.mosh.stage_two import StageTwoConfig, stage_two
from grabnet.mosh.synthesis import Flaws, spoilt
from tests.mosh.conftest import Actor
from tests.mosh.test_stages import RATE, solved

NAN = torch.nan


def line(*places: float) -> torch.Tensor:
    """(1, M, 3) markers on a line, by metres along it."""
    return torch.tensor(places).double().view(1, -1, 1) * torch.tensor([1.0, 0, 0]).double()


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        ((0, 0.1, 0.2), (0, 0.1, 0.2)),  # as they should be
        ((0.1, 0, 0.2), (0, 0.1, 0.2)),  # two exchanged
        ((0.1, 0.2, 0), (0, 0.1, 0.2)),  # three in a ring
        ((0.1, NAN, 0.2), (NAN, 0.1, 0.2)),  # the label of one that is missing
        ((0.102, 0.1, 0.2), (0.102, 0.1, 0.2)),  # that label is taken: a ghost keeps its own
        ((0.05, 0.1, 0.2), (0.05, 0.1, 0.2)),  # fits nothing
        ((0.008, 0.1, 0.2), (0.008, 0.1, 0.2)),  # near enough to its own
        ((NAN, NAN, NAN), (NAN, NAN, NAN)),
    ],
)
def test_markers_take_the_labels_that_they_fit(seen, expected):
    found = relabelled(line(0, 0.1, 0.2), line(*seen), 0.01)
    torch.testing.assert_close(found[..., 0], line(*expected)[..., 0], equal_nan=True)


def test_swapped_markers_are_in_doubt_and_their_partners_are_not():
    """Markers on a rod that tumbles; in a fifth of the frames one lies elsewhere."""
    generator = torch.Generator().manual_seed(0)
    rod = torch.rand(12, 3, generator=generator).double()
    turn = exp(torch.randn(60, 3, generator=generator).double())
    seen = rod @ turn.mT + 0.001 * torch.randn(60, 12, 3, generator=generator).double()
    seen[:, 5] = torch.where(torch.rand(60, 1, generator=generator) < 0.2, NAN, seen[:, 5])
    wrong = torch.zeros(60, 12, dtype=torch.bool)
    wrong[10:20, [2, 3]] = True
    seen[10:20, [2, 3]] = seen[10:20, [3, 2]]
    found = undoubted(seen, 0.01)
    assert ((found.isnan().any(-1) & ~seen.isnan().any(-1)) == wrong).all()
    torch.testing.assert_close(undoubted(seen, float("inf")), seen, equal_nan=True)


def test_no_marker_is_in_doubt_where_the_recording_says_nothing():
    for shape in ((1, 5), (4, 1), (3, 2)):
        seen = torch.rand(*shape, 3).double()
        assert torch.equal(undoubted(seen, 0.001), seen)
    assert undoubted(torch.full((4, 3, 3), NAN), 0.01).isnan().all()


def test_a_fiftieth_of_all_labels_swapped_costs_less_than_a_fifth():
    actor = Actor(40)
    base, swapped = (spoilt(actor.markers, 120, replace(Flaws(), swapped=share), 1) for share in (0.0, 0.02))
    assert 0.01 < (np.nan_to_num(base) != np.nan_to_num(swapped)).any(-1).mean() < 0.03
    config = StageOneConfig(annealing=(1.0, 1.0), iterations=5)
    off, places = [], []
    for seen in (base, swapped):
        clear = undoubted(torch.as_tensor(seen), config.doubt).numpy()
        one = stage_one(actor.body, actor.body.v_template, actor.layout, clear[::4], config, PriorConfig())
        places.append((one.latent - actor.latent).norm(dim=-1).mean().item())
        off.append(actor.v2v(solved(actor, seen)).mean())
    assert places[1] < 1.2 * places[0] and off[1] < 1.2 * off[0]


def test_a_finger_that_is_hidden_for_long_makes_no_jump():
    actor = Actor(72)
    seen = spoilt(actor.markers, 120, Flaws(dropped=0), 0)
    hidden = [k for k, label in enumerate(actor.layout.labels) if label.startswith("RIND")]
    seen[20:56, hidden] = np.nan
    attachment = Attachment(actor.body, actor.body.v_template, actor.truth, actor.latent)
    prior = PriorConfig()
    pose = stage_two(
        attachment, torch.as_tensor(seen), 120.0, joint_prior(actor.body, prior), prior, StageTwoConfig(),
        torch.as_tensor(actor.trunk),
    )  # fmt: skip
    joints = [JOINTS.index(f"right_index{k}") for k in (1, 2, 3)]
    off = log(actor.rotations[:, joints].mT @ pose.rotations[:, joints].double())
    assert 70 * off.diff(dim=0).norm(dim=-1).sum(1).max() < 5  # mm, of a fingertip 7 cm away


def test_long_recordings_are_solved_in_stretches_that_join_smoothly():
    actor = Actor(48)
    seen = spoilt(actor.markers, 120, Flaws(), 0)
    whole, cut = solved(actor, seen), solved(actor, seen, stretch=20)
    assert (actor.v2v(cut) < actor.v2v(whole) + 0.5).all()
    off = log(actor.rotations.mT @ cut.rotations.double())[:, [*range(1, 23), *range(25, 55)]]
    assert off.diff(dim=0).norm(dim=-1).max() < 0.2  # rad, at 24 frames per second
    seen[10:40] = np.nan  # a stretch in the middle shows nothing
    pose = solved(actor, seen, stretch=16)
    assert len(pose.transl) == 48 and all(value.isfinite().all() for value in pose)


def test_everything_is_computed_where_the_markers_are(actor):
    """With another default device than that of the markers, what is made on the default one would not fit."""
    attachment = Attachment(actor.body, actor.body.v_template, actor.truth, actor.latent)
    seen, trunk = torch.as_tensor(actor.markers), torch.as_tensor(actor.trunk)
    prior = PriorConfig(hand_components=6)
    joints = joint_prior(actor.body, prior)
    with torch.device("meta"):
        pose = stage_two(attachment, seen, RATE, joints, prior, StageTwoConfig(stretch=16), trunk)
    assert actor.v2v(pose).mean() < 3


def test_hands_that_keep_to_principal_components(actor):
    """Fingers of such a pose are found without most of their markers, which the joints' own axes cannot say."""
    mean, components = actor.body.hands_meanr, actor.body.hands_componentsr
    fingers = mean + 0.5 * components[0] - 0.4 * components[1]
    rotations = actor.rotations.clone()
    rotations[:, 40:55] = exp(fingers.double().view(15, 3))
    attachment = Attachment(actor.body, actor.body.v_template, actor.truth, actor.latent)
    pose = Pose(rotations.float(), actor.transl.float(), torch.zeros(24, 0))
    seen = attachment.place(pose).points.double()
    tips = [k for k, label in enumerate(actor.layout.labels) if label[0] == "R" and label[4:] in ("2", "3")]
    seen[:, [k for k in tips if actor.layout.labels[k][1:4] in ("IND", "MID", "RIN", "PIN", "THM")][::2]] = NAN
    off = []
    for prior in (PriorConfig(), PriorConfig(hand_components=4)):
        joints = joint_prior(actor.body, prior)
        found = stage_two(attachment, seen, RATE, joints, prior, StageTwoConfig(), torch.as_tensor(actor.trunk))
        off.append(log(rotations[:, 40:55].mT @ found.rotations[:, 40:55].double()).norm(dim=-1).mean())
    assert off[1] < 0.5 * off[0]


def test_jaw_is_solved_for_and_eyes_are_by_choice(actor):
    """With two more markers on an eyeball."""
    eye, jaw = JOINTS.index("left_eye"), JOINTS.index("jaw")
    corners = actor.body.weights[:, eye].topk(40).indices[[0, 20]].tolist()
    extra = tuple(
        replace(actor.truth.markers[0], label=f"EYE{k}", vertices=(v,) * 3, weights=(1.0, 0.0, 0.0))
        for k, v in enumerate(corners)
    )
    layout = Layout(actor.truth.name, actor.truth.n_vertices, actor.truth.markers + extra)
    latent = torch.cat([actor.latent, actor.body.v_template[corners].double()])
    rotations = actor.rotations.clone()
    rotations[:, eye] = exp(torch.tensor([0.0, 0.25, 0.0]).double())
    truth = Pose(rotations, actor.transl, torch.zeros(24, 0).double())
    found = []
    for still in ((), ("left_eye", "right_eye"), ("jaw", "left_eye", "right_eye")):
        prior = PriorConfig(still=still)
        attachment = Attachment(
            actor.body, actor.body.v_template, layout, latent, dtype=torch.float64, fixed=prior.fixed
        )
        seen = attachment.place(truth).points
        trunk = torch.cat([torch.as_tensor(actor.trunk), torch.zeros(2, dtype=torch.bool)])
        pose = stage_two(attachment, seen, RATE, joint_prior(actor.body, prior), prior, StageTwoConfig(), trunk)
        found.append(log(pose.rotations[:, [jaw, eye]]))
    opened = log(rotations[:, jaw])
    assert (found[0][:, 1, 1] - 0.25).abs().max() < 0.05
    assert (found[0][:, 0] - opened).norm(dim=-1).mean() < 0.03 and (found[1][:, 0] - opened).norm(dim=-1).mean() < 0.03
    assert not found[1][:, 1].any() and not found[2].diff(dim=0).any()
    with pytest.raises(UserError, match=r"prior\.still names tail; it can be pelvis, "):
        PriorConfig(still=("tail",))


def test_expression_is_solved_for(actor):
    directions = 0.01 * torch.randn(len(actor.body.v_template), 3, 2, generator=torch.Generator().manual_seed(0))
    attachment = Attachment(actor.body, actor.body.v_template, actor.truth, actor.latent, directions)
    values = torch.stack([torch.linspace(-1, 1, 24), torch.linspace(1, 0, 24)], 1)
    seen = attachment.place(Pose(actor.rotations.float(), actor.transl.float(), values)).points.double()
    prior = PriorConfig()
    joints = joint_prior(actor.body, prior)
    pose = stage_two(attachment, seen, RATE, joints, prior, StageTwoConfig(), torch.as_tensor(actor.trunk))
    assert (pose.shape - values).abs().mean() < 0.1
