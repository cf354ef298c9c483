"""Build the open body in SMPL-X's schema, with the open hands on its arms, and the ten subjects' shapes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree

from grabnet.body.anatomy import vertex_normals
from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.body.skeleton import JOINTS, LEFT_HAND_JOINTS, MIRROR_JOINT, PARENTS, RIGHT_HAND_JOINTS
from grabnet.io.files import replacing
from grabnet.io.npz import read_npz
from grabnet.open.body.bones import merged_weights
from grabnet.open.body.gluing import Gluing
from grabnet.open.body.source import AdultBodies, sample_bodies
from grabnet.open.body.tpose import RestBodies, to_rest_pose
from grabnet.open.grasps.store import load_open_grasps
from grabnet.open.hand.build import adult_hands
from grabnet.open.hand.flatten import FlatHands
from grabnet.open.hand.shapes import joint_regressor, principal_shapes
from grabnet.open.hand.source import cut_hands

N_BETAS = N_EXPRESSIONS = 10
_REFLECT = np.array([-1, 1, 1])


@dataclass(frozen=True)
class BodyReport:
    """Adults left out of the fit (the last quarter), in millimetres, mean and maximum; shares of variance.

    joint_error: regressed joints of the trunk and arms. shape_error: vertices, with the best betas.
    """

    joint_error: tuple[float, float]
    shape_error: tuple[float, float]
    explained: tuple[float, ...]


def build_body(folder: str | Path, n_adults: int = 400, seed: int = 0) -> BodyReport:
    """Write SMPLX_NEUTRAL.npz and subjects.npz into `folder`; needs anny (about two minutes).

    The adults must be those of the open hand (its `n_adults` and `seed`): its shapes are carried over to their hands.

    Raises:
        UserError: anny isn't installed.
    """
    adults = sample_bodies(n_adults, seed)
    hand_ids, cut = cut_hands(adults)
    hands, model = adult_hands(cut, seed), HandModel.open()
    scores, directions = hand_shapes(hands, model)
    rest, mirror = _symmetric(to_rest_pose(adults), adults.faces)
    faces = adults.faces
    glue = Gluing(rest.vertices.mean(0), faces, hand_ids)
    right = glue(rest.vertices, hands.vertices + rest.joints[:, None, RIGHT_HAND_JOINTS[0]])
    vertices = np.where((rest.vertices[..., :1] < 0), right, right[:, mirror] * _REFLECT)
    vertices -= rest.joints[:, :1]
    joints = rest.joints - rest.joints[:, :1]

    fitted = n_adults * 3 // 4
    template, shapedirs, explained = principal_shapes(vertices[:fitted], N_BETAS)
    weights = _weights(adults, hands, hand_ids, mirror)
    in_hand = hand_ids[_vertices_of(model, hands)]
    regressor = np.zeros((len(JOINTS), len(template)))
    some = slice(0, fitted, 3)
    central = [j for j, other in enumerate(MIRROR_JOINT) if other >= j and j not in LEFT_HAND_JOINTS]
    found = joint_regressor(
        vertices[some], joints[some][:, central], weights[:, central],
        [central.index(PARENTS[j]) if PARENTS[j] in central else 0 for j in central], bend=400,
    )  # fmt: skip
    regressor[central] = found
    regressor[np.ix_(RIGHT_HAND_JOINTS, in_hand)] = model.J_regressor.double().numpy()
    for j, other in enumerate(MIRROR_JOINT):
        if not regressor[j].any() or j == other:
            regressor[j] = (regressor[j] + regressor[other][mirror]) / (1 + (j == other))

    right_model, left_model = (read_npz(OPEN_HANDS / f"MANO_{side}.npz") for side in ("RIGHT", "LEFT"))
    body = {
        "v_template": template.astype(np.float32),
        "shapedirs": np.concatenate([shapedirs, np.zeros((len(template), 3, N_EXPRESSIONS))], -1).astype(np.float16),
        "posedirs": np.zeros((len(template), 3, 9 * (len(JOINTS) - 1)), np.int8),
        "J_regressor": regressor.astype(np.float32),
        "weights": weights.astype(np.float32),
        "kintree_table": np.array([[2**32 - 1, *PARENTS[1:]], range(len(JOINTS))], np.int64),
        "f": faces.astype(np.uint32),
        "lmk_faces_idx": np.zeros(51, np.int64),
        "lmk_bary_coords": np.full((51, 3), 1 / 3, np.float32),
    }
    for side, hand in (("r", right_model), ("l", left_model)):
        body |= {f"hands_{name}{side}": hand[f"hands_{name}"] for name in ("components", "mean")}
    _write(Path(folder) / "SMPLX_NEUTRAL.npz", body)

    basis = shapedirs.reshape(-1, N_BETAS)
    offset = (vertices - template).reshape(n_adults, -1).T
    betas = np.linalg.lstsq(basis, offset, rcond=None)[0].T
    subjects = {
        "betas": betas[_bodies_of_subjects(scores, adults.gender)].astype(np.float32),
        "right_hand": hand_ids.astype(np.int32),
        "left_hand": mirror[hand_ids].astype(np.int32),
        "rhand_vertices": in_hand.astype(np.int32),
        "lhand_vertices": mirror[in_hand].astype(np.int32),
        "hand_template": (hands.vertices[:fitted].mean(0)).astype(np.float32),
        "hand_shapedirs": directions.astype(np.float32),
    }
    _write(Path(folder) / "subjects.npz", subjects)
    unexplained = (offset - basis @ betas.T).T[fitted:].reshape(n_adults - fitted, -1, 3)
    return BodyReport(
        _mean_and_max((found @ vertices[fitted:]) - joints[fitted:][:, central]),
        _mean_and_max(unexplained),
        tuple(explained.round(4).tolist()),
    )


def hand_shapes(hands: FlatHands, model: HandModel) -> tuple[np.ndarray, np.ndarray]:
    """The adults' betas (N, 10) of the hand model, and its shape directions at full resolution (H, 3, 10).

    The model's vertices are some of the adults' hands', and there the directions are the model's own.
    """
    kept, fitted = _vertices_of(model, hands), len(hands.vertices) * 3 // 4
    mean = hands.vertices[:fitted].mean(0)
    basis = model.shapedirs.double().numpy().reshape(-1, N_BETAS)
    scores = np.linalg.lstsq(basis, (hands.vertices - mean)[:, kept].reshape(len(hands.vertices), -1).T, rcond=None)[0]
    scores = scores.T
    offset = (hands.vertices[:fitted] - mean).reshape(fitted, -1)
    directions = np.linalg.lstsq(scores[:fitted], offset, rcond=None)[0].T.reshape(*mean.shape, N_BETAS)
    directions[kept] = model.shapedirs.double().numpy()
    return scores, directions


def _vertices_of(model: HandModel, hands: FlatHands) -> np.ndarray:
    """(778,) which of the adults' vertices the hand model kept: its template is their mean, moved as a whole."""
    mean = hands.vertices[: len(hands.vertices) * 3 // 4].mean(0)
    joints = model.rest_joints(model.v_template)
    template = (model.v_template - joints[0]).double().numpy()  # the adults' wrists are at the origin, but for .5 mm
    for _ in range(3):
        distance, kept = cKDTree(mean).query(template)
        template += np.median(mean[kept] - template, 0)
    if distance.max() > 1e-4 or len(np.unique(kept)) < len(kept):
        raise ValueError("the open hand was made from other adults than these: give its number and seed")
    return kept


def _symmetric(rest: RestBodies, faces: np.ndarray) -> tuple[RestBodies, np.ndarray]:
    """Bodies averaged with their mirror images, and (V,) each vertex's image."""
    mean = rest.vertices.mean(0)
    mean[:, 0] -= rest.joints[:, 0, 0].mean()
    mirror = mirror_images(mean, faces)
    vertices = (rest.vertices + rest.vertices[:, mirror] * _REFLECT) / 2
    joints = (rest.joints + rest.joints[:, MIRROR_JOINT] * _REFLECT) / 2
    return RestBodies(vertices, joints), mirror


def mirror_images(vertices: np.ndarray, faces: np.ndarray, nearest: int = 12) -> np.ndarray:
    """(V,) for each vertex of a body about symmetric to x = 0 the one that is its image, pairwise.

    Nearest pairs first; normals tell apart the vertices of lids and lips, which touch.
    """
    normals = vertex_normals(torch.as_tensor(vertices), torch.as_tensor(faces)).numpy()
    place = np.concatenate([vertices, 0.01 * normals], 1)
    mirror = np.full(len(vertices), -1)
    while len(left := (mirror < 0).nonzero()[0]):
        distance, image = cKDTree(place[left]).query(place[left] * np.tile(_REFLECT, 2), min(nearest, len(left)))
        order = np.argsort(distance, axis=None, kind="stable")
        for one, other in zip(left[order // distance.shape[1]], left[image.ravel()[order]], strict=True):
            if mirror[one] < 0 and mirror[other] < 0:
                mirror[one], mirror[other] = other, one
    return mirror


def _weights(adults: AdultBodies, hands: FlatHands, ids: np.ndarray, mirror: np.ndarray) -> np.ndarray:
    """(V, 55) MakeHuman's, but the open hand's own for the fingers; exactly symmetric."""
    weights = merged_weights(adults.weights, adults.bones, adults.parents)
    behind = weights[ids]
    behind[:, list(RIGHT_HAND_JOINTS[1:])] = 0
    behind[behind.sum(1) == 0, RIGHT_HAND_JOINTS[0]] = 1
    weights[ids] = behind / behind.sum(1, keepdims=True) * hands.weights[:, :1]
    weights[ids[:, None], RIGHT_HAND_JOINTS[1:]] = hands.weights[:, 1:]
    other = weights[mirror][:, MIRROR_JOINT]
    in_left = np.isin(np.arange(len(weights)), mirror[ids])
    in_right = np.isin(np.arange(len(weights)), ids)
    weights = np.where(in_left[:, None], other, np.where(in_right[:, None], weights, (weights + other) / 2))
    weights = np.where(weights < 1e-3, 0, weights)
    return weights / weights.sum(1, keepdims=True)


def _bodies_of_subjects(scores: np.ndarray, gender: np.ndarray, clear: float = 0.3) -> list[int]:
    """(10,) for each subject of the open grasps another adult of the same sex, whose hand is most alike."""
    grasps = load_open_grasps()
    chosen: list[int] = []
    for betas, sex in zip(grasps.betas.numpy(), grasps.genders, strict=True):
        fits = gender < clear if sex == "male" else gender > 1 - clear
        fits[chosen] = False
        size = np.array([3, *[1] * 9])  # the first beta is the hand's size, which goes with the body's
        apart = np.where(fits, (((scores - betas) * size) ** 2).sum(1), np.inf)
        chosen.append(int(apart.argmin()))
    return chosen


def _write(path: Path, arrays: dict[str, np.ndarray]) -> None:
    with replacing(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def _mean_and_max(difference: np.ndarray) -> tuple[float, float]:
    """(..., 3) metres → millimetres."""
    error = np.linalg.norm(difference, axis=-1) * 1000
    return float(error.mean()), float(error.max())
