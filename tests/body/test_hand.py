"""The hand model against smplx, on the open hands and on a random model with pose correctives."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
import smplx
import torch

from grabnet.body.hand import OPEN_HANDS, HandModel, HandParameters
from grabnet.geometry.rotations import axis_angle_to_matrix, random_rotations

CLOSE = {"atol": 1e-5, "rtol": 0}


@pytest.fixture(scope="module", params=["open right", "open left", "random right", "random left"])
def model_file(request, tmp_path_factory, random_mano):
    kind, side = request.param.split()
    name = f"MANO_{side.upper()}.npz"
    if kind == "open":
        return OPEN_HANDS / name
    path = tmp_path_factory.mktemp("mano") / name
    np.savez(path, **random_mano)
    return path


def reference(path, **options):
    with contextlib.redirect_stdout(io.StringIO()):  # smplx prints about betas
        return smplx.create(
            str(path), "mano", ext="npz", is_rhand="RIGHT" in path.name,
            **{"use_pca": False, "flat_hand_mean": True} | options,
        )  # fmt: skip


def random_pose(n, dtype=torch.float32, seed=0):
    generator = torch.Generator().manual_seed(seed)
    orient, pose, transl, betas = (
        torch.randn(n, k, generator=generator, dtype=dtype) * size
        for k, size in ((3, 2.0), (45, 0.6), (3, 0.3), (10, 1.5))
    )
    parameters = HandParameters(axis_angle_to_matrix(orient), axis_angle_to_matrix(pose.view(n, 15, 3)), transl)
    return {"global_orient": orient, "hand_pose": pose, "transl": transl, "betas": betas}, parameters


def assert_same(ours, theirs):
    torch.testing.assert_close(ours.vertices, theirs.vertices, **CLOSE)
    torch.testing.assert_close(ours.joints, theirs.joints[:, :16], **CLOSE)


@pytest.mark.parametrize("batch", [1, 7])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_agrees_with_smplx(model_file, dtype, batch):
    values, parameters = random_pose(batch, dtype)
    hand = HandModel(model_file, dtype)
    theirs = reference(model_file, dtype=dtype)(**values)
    assert_same(hand(parameters, hand.shaped(values["betas"])), theirs)


def test_one_shape_for_the_whole_batch_agrees_with_smplx(model_file):
    values, parameters = random_pose(7)
    values["betas"] = values["betas"][:1].expand(7, 10)
    hand = HandModel(model_file)
    assert_same(hand(parameters, hand.shaped(values["betas"][0])), reference(model_file)(**values))


def test_v_template_agrees_with_smplx(model_file):
    values, parameters = random_pose(5)
    values["betas"] = torch.zeros(5, 10)
    hand = HandModel(model_file)
    v_template = hand.shaped(torch.randn(10, generator=torch.Generator().manual_seed(3)))
    theirs = reference(model_file, v_template=v_template)(**values)
    assert_same(hand(parameters, v_template), theirs)
    assert_same(hand(parameters, v_template.expand(5, -1, -1)), theirs)


@pytest.mark.parametrize("flat_hand_mean", [True, False])
@pytest.mark.parametrize("n", [6, 24, 44])  # told 45, smplx takes axis-angle instead
def test_principal_components_agree_with_smplx(model_file, n, flat_hand_mean):
    values, parameters = random_pose(4)
    components = torch.randn(4, n, generator=torch.Generator().manual_seed(1))
    hand = HandModel(model_file)
    pose = axis_angle_to_matrix(hand.pose_from_pca(components, flat_hand_mean).view(4, 15, 3))
    theirs = reference(model_file, use_pca=True, num_pca_comps=n, flat_hand_mean=flat_hand_mean)
    ours = hand(parameters._replace(hand_pose=pose), hand.shaped(values["betas"]))
    assert_same(ours, theirs(**values | {"hand_pose": components}))


def test_an_empty_batch_gives_no_hands(model_file):
    hand = HandModel(model_file)
    _, parameters = random_pose(0)
    for rest in (None, hand.shaped(torch.zeros(0, 10))):
        posed = hand(parameters, rest)
        assert posed.vertices.shape == (0, 778, 3)
        assert posed.joints.shape == (0, 16, 3)


def test_a_batch_is_its_elements(model_file):
    hand = HandModel(model_file)
    values, parameters = random_pose(7)
    rest = hand.shaped(values["betas"])
    whole = hand(parameters, rest).vertices
    for i in range(7):
        torch.testing.assert_close(hand(parameters.select(slice(i, i + 1)), rest[i]).vertices[0], whole[i], **CLOSE)


@pytest.mark.parametrize("shared_rest", [True, False])
def test_gradients_against_finite_differences(tmp_path, random_mano, shared_rest):
    """On a cut-down model: 7 vertices keep the Jacobian small, the formulas are the same."""
    arrays = dict(random_mano)
    some = np.arange(0, 778, 111)[:7]
    regressor = arrays["J_regressor"][:, some]
    arrays |= {name: arrays[name][some] for name in ("v_template", "shapedirs", "posedirs", "weights")}
    arrays |= {"J_regressor": regressor / regressor.sum(1, keepdims=True), "f": np.array([[0, 1, 2]])}
    np.savez(tmp_path / "MANO_RIGHT.npz", **arrays)
    hand = HandModel(tmp_path / "MANO_RIGHT.npz", torch.float64)
    _, parameters = random_pose(2, torch.float64)
    betas = torch.randn(2, 10, dtype=torch.float64)[0 if shared_rest else slice(None)].requires_grad_()

    def vertices(orient, pose, transl, betas):
        return tuple(hand(HandParameters(orient, pose, transl), hand.shaped(betas)))

    assert torch.autograd.gradcheck(vertices, (*(x.requires_grad_() for x in parameters), betas))


def test_gradients_are_finite_at_the_flat_hand():
    hand = HandModel.open()
    pose = torch.zeros(2, 15, 3, requires_grad=True)
    orient = torch.zeros(2, 3, requires_grad=True)
    parameters = HandParameters(axis_angle_to_matrix(orient), axis_angle_to_matrix(pose), torch.zeros(2, 3))
    hand(parameters).vertices.square().sum().backward()
    assert pose.grad.isfinite().all() and orient.grad.isfinite().all()
    assert (pose.grad.abs().amax(-1) > 0).all(), "every joint moves something"


def test_moving_the_parameters_moves_the_hand():
    hand = HandModel.open()
    values, parameters = random_pose(6)
    rotation = random_rotations(6, torch.Generator().manual_seed(5))
    translation = torch.randn(6, 3, generator=torch.Generator().manual_seed(6))
    for rest in (None, hand.shaped(values["betas"])):
        expected = hand(parameters, rest).vertices @ rotation.mT + translation.unsqueeze(1)
        moved = hand(hand.moved(parameters, rotation, translation, rest), rest)
        torch.testing.assert_close(moved.vertices, expected, **CLOSE)


def test_the_left_hand_is_the_right_one_in_a_mirror():
    right, left = HandModel.open("right"), HandModel.open("left")
    values, parameters = random_pose(3)
    mirror = torch.tensor([-1.0, 1, 1])
    flip = mirror.diag()
    mirrored = HandParameters(flip @ parameters.global_orient @ flip, flip @ parameters.hand_pose @ flip,
                              parameters.transl * mirror)  # fmt: skip
    here = right(parameters, right.shaped(values["betas"]))
    there = left(mirrored, left.shaped(values["betas"]))
    torch.testing.assert_close(here.vertices * mirror, there.vertices, atol=1e-6, rtol=0)
    torch.testing.assert_close(here.joints * mirror, there.joints, atol=1e-6, rtol=0)


def test_fewer_betas_than_the_model_has_and_more():
    hand = HandModel.open()
    betas = torch.randn(4, 3, generator=torch.Generator().manual_seed(0))
    padded = torch.nn.functional.pad(betas, (0, 7))
    torch.testing.assert_close(hand.shaped(betas), hand.shaped(padded))
    with pytest.raises(ValueError, match="11 betas given, but this hand model has 10"):
        hand.shaped(torch.zeros(1, 11))


@pytest.mark.parametrize("name", ["v_template", "J_regressor", "weights", "posedirs"])
def test_the_fingerprint_is_of_all_that_gives_a_pose_its_meaning(tmp_path, random_mano, name):
    prints = []
    for number, change in enumerate((0, 0, 1e-3)):
        path = tmp_path / str(number) / "MANO_RIGHT.npz"
        path.parent.mkdir()
        np.savez(path, **random_mano | {name: random_mano[name] + change})
        prints.append(HandModel(path, dtype=torch.float64 if number else torch.float32).fingerprint)
    assert prints[0] == prints[1] != prints[2]
