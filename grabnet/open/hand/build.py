"""Build the open hand, right and left, in MANO's schema."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.io.files import replacing
from grabnet.open.hand.decimate import decimate
from grabnet.open.hand.flatten import FlatHands, flatten
from grabnet.open.hand.knuckles import move_knuckles
from grabnet.open.hand.poses import grasp_poses, principal_poses, relaxed_pose
from grabnet.open.hand.shapes import calibrate, joint_regressor, principal_shapes, vary
from grabnet.open.hand.source import AdultHands, sample_adults

PARENTS = (-1, 0, 1, 2, 0, 4, 5, 0, 7, 8, 0, 10, 11, 0, 13, 14)
Model = dict[str, np.ndarray]


@dataclass(frozen=True)
class HandReport:
    """How well the model fits adults that it was not made from (the last quarter), in millimetres, mean and maximum.

    joint_error: regressed joints. shape_error: vertices, with the best betas. explained: share of the shapes' variance
    by component.
    """

    joint_error: tuple[float, float]
    shape_error: tuple[float, float]
    explained: tuple[float, ...]


def build_hands(folder: str | Path, n_adults: int = 400, seed: int = 0) -> HandReport:
    """Write MANO_RIGHT.npz and MANO_LEFT.npz into `folder`; needs anny (about a minute the first time).

    Raises:
        UserError: anny isn't installed.
    """
    right, report = right_hand(sample_adults(n_adults, seed), seed)
    right = with_poses(right, seed)
    for side, model in (("RIGHT", right), ("LEFT", mirrored(right))):
        _write(Path(folder) / f"MANO_{side}.npz", model)
    return report


def right_hand(
    adults: AdultHands, seed: int, n_vertices: int = 778, n_boundary: int = 16, n_betas: int = 10
) -> tuple[Model, HandReport]:
    """The right hand in MANO's schema, its pose components still the unit matrix.

    The counts of vertices and of the wrist opening's vertices are MANO's.
    """
    hands = adult_hands(adults, seed)
    kept, faces = decimate(hands.vertices.mean(0), hands.faces, n_vertices, n_boundary, hands.weights)
    hands = FlatHands(hands.vertices[:, kept], faces, hands.joints, hands.weights[kept])
    fitted = len(hands.vertices) * 3 // 4
    template, shapedirs, explained = principal_shapes(hands.vertices[:fitted], n_betas)
    regressor = joint_regressor(hands.vertices[:fitted], hands.joints[:fitted], hands.weights, PARENTS)
    model = {
        "v_template": template - template.mean(0),
        "shapedirs": shapedirs,
        "posedirs": np.zeros((n_vertices, 3, 135)),
        "J_regressor": regressor,
        "weights": hands.weights,
        "hands_components": np.eye(45),
        "hands_mean": np.zeros(45),
    }
    model = {name: array.astype(np.float32) for name, array in model.items()}
    model["f"] = faces.astype(np.uint32)
    model["kintree_table"] = np.array([[2**32 - 1, *PARENTS[1:]], range(16)], np.uint32)

    held_out = hands.vertices[fitted:]
    basis = shapedirs.reshape(-1, n_betas)
    offset = (held_out - template).reshape(len(held_out), -1).T
    unexplained = offset - basis @ np.linalg.lstsq(basis, offset, rcond=None)[0]
    return model, HandReport(
        joint_error=_mean_and_max(regressor @ held_out - hands.joints[fitted:]),
        shape_error=_mean_and_max(unexplained.T.reshape(held_out.shape)),
        explained=tuple(explained.round(4).tolist()),
    )


def adult_hands(adults: AdultHands, seed: int) -> FlatHands:
    """The adults' hands in rest pose, at full resolution."""
    return calibrate(vary(move_knuckles(flatten(adults)), seed))


def with_poses(model: Model, seed: int, n_poses: int = 4000) -> Model:
    """The model with a relaxed mean pose and principal components of grasp poses about its own joint axes."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "MANO_RIGHT.npz"
        _write(path, model)
        anatomy = Anatomy.of(HandModel(path, dtype=torch.float64))
    components = principal_poses(grasp_poses(anatomy, n_poses, seed))
    return model | {
        "hands_components": components.astype(np.float32),
        "hands_mean": relaxed_pose(anatomy).astype(np.float32),
    }


def mirrored(model: Model) -> Model:
    """The other hand: reflected in the plane x = 0; joint axes mirror as (x, −y, −z)."""
    axial = np.tile(np.array([1, -1, -1], np.float32), 15)
    reflect = np.array([-1, 1, 1], np.float32)
    return model | {
        "v_template": model["v_template"] * reflect,
        "shapedirs": model["shapedirs"] * reflect[:, None],
        "f": model["f"][:, ::-1],
        "hands_components": model["hands_components"] * axial,
        "hands_mean": model["hands_mean"] * axial,
    }


def _write(path: Path, model: Model) -> None:
    with replacing(path) as temporary:
        np.savez_compressed(temporary, **model)


def _mean_and_max(difference: np.ndarray) -> tuple[float, float]:
    """(..., 3) metres → millimetres."""
    error = np.linalg.norm(difference, axis=-1) * 1000
    return float(error.mean()), float(error.max())
