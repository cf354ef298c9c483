"""The solids that stand for objects and hands in simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from hydra.utils import instantiate
from omegaconf import OmegaConf

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.cli.entry import CONFIGS
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import close
from grabnet.geometry.queries import MeshQuery
from grabnet.physics.coacd_process import CoacdError, cut
from grabnet.physics.decomposition import DecompositionConfig, DecompositionError, convex_pieces, decomposed
from grabnet.physics.hand_pieces import hand_pieces

SHIPPED: DecompositionConfig = instantiate(OmegaConf.load(CONFIGS / "evaluate.yaml").physics.decomposition)
CONFIG = replace(SHIPPED, resolution=200, nodes=6, iterations=10, remeshing=20)  # quick


def mesh(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(shape.vertices, shape.faces)


def volume(pieces: list[np.ndarray]) -> float:
    return sum(trimesh.convex.convex_hull(piece).volume for piece in pieces)


def inside(pieces: list[np.ndarray], points: np.ndarray, margin: float = 0.0) -> np.ndarray:
    """Whether each of points (N, 3) is inside any piece, by more than a margin."""
    hulls = [trimesh.convex.convex_hull(piece) for piece in pieces]
    depths = [
        np.einsum("fi,fni->fn", hull.face_normals, points - hull.triangles_center[:, None]).max(0) for hull in hulls
    ]
    return np.min(depths, 0) < -margin


@pytest.fixture(scope="module")
def torus() -> Mesh:
    return mesh(trimesh.creation.torus(0.04, 0.01, major_sections=32, minor_sections=16))


def test_pieces_follow_a_torus_and_leave_its_hole_open(torus, tmp_path):
    pieces = convex_pieces(torus, CONFIG, tmp_path)
    assert len(pieces) > 4
    assert volume(pieces) == pytest.approx(torus.volume, rel=0.1)
    corners = np.concatenate(pieces)
    assert (np.abs(np.hypot(np.hypot(*corners[:, :2].T) - 0.04, corners[:, 2]) - 0.01) < 5e-4).all()
    assert not inside(pieces, np.array([[0, 0, 0], [0.024, 0, 0], [0, -0.024, 0]])).any()
    assert inside(pieces, np.array([[0.04, 0, 0], [0, -0.04, 0]])).all()


def test_pieces_are_the_same_each_time_and_kept(torus, tmp_path):
    built = convex_pieces(torus, CONFIG, tmp_path)
    (file,) = tmp_path.iterdir()
    written = file.stat().st_mtime_ns
    for again in (convex_pieces(torus, CONFIG, tmp_path), decomposed(torus, CONFIG)):
        assert all(np.array_equal(a, b) for a, b in zip(built, again, strict=True))
    assert file.stat().st_mtime_ns == written


def test_what_takes_too_long_is_refused_and_that_is_kept(torus, tmp_path):
    endless = replace(CONFIG, resolution=10_000, nodes=50, iterations=100_000, time_limit=1)
    with pytest.raises(DecompositionError, match=r"1024 faces isn't cut: CoACD was not done after 1 s; repair it"):
        convex_pieces(torus, endless, tmp_path)
    (file,) = tmp_path.iterdir()
    written = file.stat().st_mtime_ns
    with pytest.raises(DecompositionError, match="not done after 1 s"):
        convex_pieces(torus, endless, tmp_path)
    assert file.stat().st_mtime_ns == written


def test_a_crash_of_coacd_ends_nothing_else():
    with pytest.raises(CoacdError, match="CoACD ended with code"):
        cut(np.eye(3), np.array([[0, 1, 1_000_000_000]], np.int32), 30, preprocess_mode="off")


def test_a_damaged_cache_is_rebuilt_with_a_warning(tmp_path):
    box = mesh(trimesh.creation.box((0.05, 0.06, 0.08)))
    built = convex_pieces(box, CONFIG, tmp_path)
    (file,) = tmp_path.iterdir()
    for damage in (b"not a tensor in sight", file.read_bytes()[:-10]):
        file.write_bytes(damage)
        with pytest.warns(UserWarning, match="damaged"):
            again = convex_pieces(box, CONFIG, tmp_path)
        assert np.array_equal(again[0], built[0])
    convex_pieces(box, CONFIG, tmp_path)  # whole again: a warning would be an error here


def test_a_box_is_one_piece_whichever_way_its_faces_look():
    box = mesh(trimesh.creation.box((0.05, 0.06, 0.08)))
    for surface in (box, Mesh(box.vertices, box.faces[:, ::-1])):
        (piece,) = decomposed(surface, CONFIG)
        assert volume([piece]) == pytest.approx(0.05 * 0.06 * 0.08, rel=1e-5)


def test_many_faces_take_little_time_and_less_than_a_millimetre():
    (piece,) = decomposed(mesh(trimesh.creation.icosphere(6, 0.04)), CONFIG)  # 81,920 faces
    assert len(piece) <= CONFIG.max_corners
    np.testing.assert_allclose(np.linalg.norm(piece, axis=1), 0.04, atol=2e-4)
    hull = trimesh.convex.convex_hull(piece)
    assert np.einsum("fi,fi->f", hull.face_normals, hull.triangles_center).min() > 0.039


def test_parts_that_overlap_are_one_solid():
    box = trimesh.creation.box((0.05, 0.06, 0.08))
    other = box.copy().apply_translation((0.02, 0.02, 0.02))
    pieces = decomposed(mesh(trimesh.util.concatenate([box, other])), CONFIG)
    both = 2 * 0.05 * 0.06 * 0.08
    shared = 0.03 * 0.04 * 0.06
    assert both - shared < volume(pieces) < both  # remeshing so coarsely adds half a cell on all sides
    notch = np.array([[0.04, -0.025, -0.035], [-0.02, 0.045, 0.055]])
    assert not inside(pieces, notch).any()
    assert inside(pieces, np.array([[0, 0, 0], [0.03, 0.03, 0.03]])).all()


def test_a_sheet_gets_thin_pieces_and_what_is_out_of_range_is_refused():
    sheet = Mesh([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], [[0, 1, 2], [0, 2, 3]])
    corners = np.concatenate(decomposed(sheet, CONFIG))
    np.testing.assert_allclose(np.ptp(corners, axis=0)[:2], 0.1, atol=0.01)
    assert 0 < np.ptp(corners[:, 2]) < 0.015
    with pytest.raises(UserError, match="concavity is 0"):
        DecompositionConfig(**(vars(CONFIG) | {"concavity": 0.0}))


@pytest.fixture(scope="module")
def solids(hand: HandModel) -> list[np.ndarray]:
    rest = hand.v_template.numpy()
    return [rest[piece] for piece in hand_pieces(hand.weights.numpy(), rest)]


def test_every_vertex_of_the_hand_is_in_a_piece(hand):
    for model in (hand, HandModel.open("left")):
        pieces = hand_pieces(model.weights.numpy(), model.v_template.numpy())
        assert set(np.concatenate(pieces)) == set(range(len(model.v_template)))
        assert len(pieces) > 15 + 8


def test_the_hand_s_pieces_fill_it_and_little_more(hand, solids):
    """Points spread over the hand's box: nearly all inside the skin are in a piece, and no piece reaches far out."""
    query = MeshQuery(Mesh(*close(hand.v_template.numpy(), hand.faces.numpy())))
    generator = np.random.default_rng(0)
    low, high = hand.v_template.numpy().min(0), hand.v_template.numpy().max(0)
    points = generator.uniform(low, high, (20_000, 3)).astype(np.float32)
    depth = -query.signed_distance(torch.tensor(points)).numpy()
    covered = inside(solids, points)
    assert covered[depth > 0].mean() > 0.9
    assert (-depth[covered]).max() < 0.006
    assert (covered & (depth < -0.002)).sum() < 0.03 * covered.sum()


def test_there_is_room_between_thumb_and_index_finger(hand, solids):
    anatomy = Anatomy.of(hand)
    thumb, index = hand.v_template[anatomy.tips[0]].numpy(), hand.v_template[anatomy.tips[1]].numpy()
    joints = hand.rest_joints(hand.v_template).numpy()
    between = np.stack([(thumb + index) / 2, (thumb + joints[2]) / 2, (joints[15] + joints[2]) / 2])
    assert not inside(solids, between).any()
