"""The whole body against smplx, on random models of SMPL-X's exact shapes."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
import smplx
import torch

from grabnet.body.whole import BodyModel, BodyParameters
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix

CLOSE = {"atol": 1e-5, "rtol": 0}
# smplx's names of the pose, and their joints, in the order of `fullpose`.
JOINTS = {"global_orient": 1, "body_pose": 21, "jaw_pose": 1, "leye_pose": 1, "reye_pose": 1,
          "left_hand_pose": 15, "right_hand_pose": 15}  # fmt: skip


@pytest.fixture(scope="module", params=[20, 400], ids=["20 directions", "400 directions"])
def model_file(request, tmp_path_factory, random_smplx):
    path = tmp_path_factory.mktemp("smplx") / "SMPLX_NEUTRAL.npz"
    arrays = dict(random_smplx)
    if request.param == 400:
        rng = np.random.default_rng(2)
        arrays["shapedirs"] = 0.005 * rng.standard_normal((10475, 3, 400), np.float32)
    np.savez(path, **arrays)
    return path


@pytest.fixture(scope="module")
def body(model_file):
    return BodyModel(model_file)


def reference(path, **options):
    with contextlib.redirect_stdout(io.StringIO()):
        return smplx.create(
            str(path), "smplx", ext="npz", **{"use_pca": False, "flat_hand_mean": True, "batch_size": 3} | options
        )


def random_pose(n=3):
    generator = torch.Generator().manual_seed(0)
    values = {name: 0.4 * torch.randn(n, 3 * k, generator=generator) for name, k in JOINTS.items()}
    values |= {"transl": torch.randn(n, 3, generator=generator), "betas": torch.randn(n, 10, generator=generator)}
    values["expression"] = torch.randn(n, 10, generator=generator)
    matrices = [axis_angle_to_matrix(values[name].view(n, -1, 3)) for name in JOINTS]
    return values, BodyParameters.from_rotations(torch.cat(matrices, 1), values["transl"])


def assert_same(ours, theirs):
    torch.testing.assert_close(ours.vertices, theirs.vertices, **CLOSE)
    torch.testing.assert_close(ours.joints, theirs.joints[:, :55], **CLOSE)


def test_agrees_with_smplx(model_file, body):
    values, parameters = random_pose()
    rest = body.shaped(values["betas"], values["expression"])
    assert_same(body(parameters, rest), reference(model_file)(**values))


def test_v_template_with_expression_agrees_with_smplx(model_file, body):
    """GRAB's way: the subject's template replaces betas, faces move."""
    values, parameters = random_pose()
    values["betas"] = torch.zeros(3, 10)
    v_template = body.shaped(torch.randn(10, generator=torch.Generator().manual_seed(3)))
    rest = body.shaped(expression=values["expression"], v_template=v_template)
    assert_same(body(parameters, rest), reference(model_file, v_template=v_template)(**values))


@pytest.mark.parametrize("flat_hand_mean", [True, False])
def test_hands_by_principal_components_agree_with_smplx(model_file, body, flat_hand_mean):
    values, parameters = random_pose()
    components = torch.randn(2, 3, 24, generator=torch.Generator().manual_seed(1))
    left, right = (
        axis_angle_to_matrix(body.hand_pose_from_pca(c, side, flat_hand_mean).view(3, 15, 3))
        for c, side in zip(components, ("left", "right"), strict=True)
    )
    theirs = reference(model_file, use_pca=True, num_pca_comps=24, flat_hand_mean=flat_hand_mean)(
        **values | {"left_hand_pose": components[0], "right_hand_pose": components[1]}
    )
    parameters = parameters._replace(left_hand_pose=left, right_hand_pose=right)
    assert_same(body(parameters, body.shaped(values["betas"], values["expression"])), theirs)


def test_each_part_of_the_pose_moves_what_hangs_on_it(body):
    """By the tree alone: joints that move when one part turns are exactly those below it."""
    rest = axis_angle_to_matrix(torch.zeros(1, 55, 3))
    still = body(BodyParameters.from_rotations(rest, torch.zeros(1, 3))).joints[0]
    turn = axis_angle_to_matrix(torch.tensor([0.3, 0.5, -0.2]))
    for joint in (0, 9, 15, 20, 22, 25, 53):
        rotations = rest.clone()
        rotations[0, joint] = turn
        moved = body(BodyParameters.from_rotations(rotations, torch.zeros(1, 3))).joints[0]
        below = {joint}
        for child in range(joint + 1, 55):
            if body.parents[child] in below:
                below.add(child)
        changed = (moved - still).norm(dim=-1) > 1e-6
        assert set(changed.nonzero().flatten().tolist()) == below - {joint}


def test_parts_and_rotations_are_the_same_pose():
    _, parameters = random_pose()
    again = BodyParameters.from_rotations(parameters.rotations, parameters.transl)
    assert parameters.rotations.shape == (3, 55, 3, 3)
    assert all(torch.equal(a, b) for a, b in zip(parameters, again, strict=True))


def test_gradients_reach_every_part(body):
    _, parameters = random_pose(1)
    parameters = BodyParameters(*(x.requires_grad_() for x in parameters))
    body(parameters).vertices.square().sum().backward()
    assert all((x.grad.abs() > 0).any() for x in parameters)


def test_too_many_values_are_refused(body):
    with pytest.raises(ValueError, match="betas given, but this body model has"):
        body.shaped(torch.zeros(1, body.n_betas + 1))
    with pytest.raises(ValueError, match="expression values given, but this body model has"):
        body.shaped(expression=torch.zeros(1, body.n_expressions + 1))


def test_a_hand_is_no_body(tmp_path, random_mano):
    np.savez(tmp_path / "MANO_RIGHT.npz", **random_mano)
    with pytest.raises(UserError, match=r"MANO_RIGHT\.npz lacks hands_.* it is no model in SMPL-X's schema"):
        BodyModel(tmp_path / "MANO_RIGHT.npz")
