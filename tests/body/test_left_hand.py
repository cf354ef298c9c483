"""Left hands whose shapes move along x as the right hand's do, as in the published file."""

from __future__ import annotations

import pickle
import shutil
import warnings

import numpy as np
import pytest
import torch

from grabnet.body.hand import OPEN_HANDS, HandModel


@pytest.fixture(scope="module")
def published() -> dict[str, np.ndarray]:
    """The open left hand with the published one's fault."""
    arrays = dict(np.load(OPEN_HANDS / "MANO_LEFT.npz"))
    arrays["shapedirs"] = arrays["shapedirs"] * np.array([[-1], [1], [1]], np.float32)
    return arrays


def save(folder, arrays, kind):
    path = folder / f"MANO_LEFT.{kind}"
    if kind == "npz":
        np.savez(path, **arrays)
    else:
        path.write_bytes(pickle.dumps(arrays, 2))
    return path


@pytest.mark.parametrize("kind", ["npz", "pkl"])
@pytest.mark.parametrize("has_right", [True, False])
def test_the_published_fault_is_mended_and_said(tmp_path, published, kind, has_right):
    if has_right:
        shutil.copy(OPEN_HANDS / "MANO_RIGHT.npz", tmp_path)
        published = published | {"hands_mean": published["hands_mean"] + 0.1}  # its pose does not matter
    path = save(tmp_path, published, kind)
    if has_right and kind == "pkl":
        right = dict(np.load(tmp_path / "MANO_RIGHT.npz"))
        (tmp_path / "MANO_RIGHT.pkl").write_bytes(pickle.dumps(right, 2))
    with pytest.warns(UserWarning, match=f"{path}: 10 of its 10 shape directions have the right hand's sign") as said:
        left = HandModel(path)
    assert len(said) == 1
    betas = torch.tensor([3.0, -2, 1, 0, 0.5, 0, 0, 1, 0, 0])
    mirrored = HandModel.open("right").shaped(betas) * torch.tensor([-1.0, 1, 1])
    torch.testing.assert_close(left.shaped(betas), mirrored, atol=1e-6, rtol=0)


def test_only_directions_that_are_wrong_are_mended(tmp_path):
    """With the right hand beside, each direction is compared by itself."""
    shutil.copy(OPEN_HANDS / "MANO_RIGHT.npz", tmp_path)
    arrays = dict(np.load(OPEN_HANDS / "MANO_LEFT.npz"))
    true = arrays["shapedirs"].copy()
    arrays["shapedirs"][:, 0, [0, 3]] *= -1
    with pytest.warns(UserWarning, match="2 of its 10"):
        left = HandModel(save(tmp_path, arrays, "npz"))
    np.testing.assert_array_equal(left.shapedirs, true)


@pytest.mark.parametrize("beside", ["nothing", "right", "damaged", "other"])
def test_right_and_whole_left_hands_stay_as_they_are(tmp_path, random_mano, beside):
    open_left = dict(np.load(OPEN_HANDS / "MANO_LEFT.npz"))
    for arrays in (open_left, random_mano):
        path = save(tmp_path, arrays, "npz")
        if beside == "right":
            shutil.copy(OPEN_HANDS / "MANO_RIGHT.npz", tmp_path)
        elif beside == "damaged":
            (tmp_path / "MANO_RIGHT.npz").write_bytes(b"PK")
        elif beside == "other":
            np.savez(tmp_path / "MANO_RIGHT.npz", **random_mano)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            left = HandModel(path)
        np.testing.assert_array_equal(left.shapedirs, arrays["shapedirs"].astype(np.float32))
