import numpy as np
import pytest

from grabnet.data.frames import FramesStore
from grabnet.data.objects import OBJECT_MESHES
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.protocols.ground_truth import ClosestHand, closest_map_error
from grabnet.evaluation.recorded import ground_truth_sample, held_out, recorded_hands, same_sequence
from grabnet.geometry.mesh import load_mesh
from grabnet.geometry.rotations import axis_angle_to_matrix
from tests.evaluation.shapes import ball, scene

TRIANGLE = np.array([[0, 1, 2]])


def random_hands(seed: int, n: int, sequences: list[int] | None = None) -> Hands:
    vertices = np.random.default_rng(seed).normal(size=(n, 7, 3)).astype(np.float32)
    return Hands(vertices=vertices, faces=TRIANGLE, sequences=None if sequences is None else np.array(sequences))


def brute_force(hand: np.ndarray, others: np.ndarray) -> float:
    return min(
        sum(float(np.sqrt(((a - b) ** 2).sum())) for a, b in zip(hand, other, strict=True)) / len(hand)
        for other in others.astype(float)
    )


def test_the_closest_hand_vertex_by_vertex():
    reference, made = random_hands(0, 6, [0, 0, 1, 1, 2, 2]), random_hands(1, 4)
    found = ClosestHand()(scene(ball(1), made, reference))
    expected = [100 * brute_force(hand, reference.vertices) for hand in made.vertices]
    np.testing.assert_allclose(found["vertices"], expected, rtol=1e-6)
    outside = reference.vertices[[2, 3]]
    nearest = [min((0, 1), key=lambda k: brute_force(hand, outside[k : k + 1])) for hand in made.vertices]
    assert found["nearest"].tolist() == nearest


def test_ground_truth_is_compared_with_other_recordings():
    reference = random_hands(0, 6, [0, 0, 1, 1, 2, 2])
    found = ClosestHand()(scene(ball(1), reference, reference))["vertices"]
    for i, sequence in enumerate(reference.sequences):
        others = reference.vertices[reference.sequences != sequence]
        assert found[i] == pytest.approx(100 * brute_force(reference.vertices[i], others), rel=1e-6)
    alone = random_hands(0, 3, [5, 5, 5])
    assert np.isnan(ClosestHand()(scene(ball(1), alone, alone))["vertices"]).all()


def test_hands_of_other_vertices_have_no_closest_hand():
    other = Hands(vertices=np.zeros((2, 8, 3), np.float32), faces=TRIANGLE)
    assert np.isnan(ClosestHand()(scene(ball(1), other, random_hands(0, 4, [0, 0, 1, 1])))["vertices"]).all()


def test_the_row_of_ground_truth_shares_no_recording_with_what_is_held_out():
    reference = random_hands(0, 12, [0, 0, 0, 1, 1, 1, 4, 4, 4, 7, 7, 7])
    kept = set(reference.sequences[held_out(reference)])
    row = ground_truth_sample(reference, 4, 0)
    assert kept == {1, 7}
    assert len(row) == 4
    assert not kept & set(row.sequences)
    assert len(ground_truth_sample(reference, 100, 0)) == 6
    np.testing.assert_array_equal(ground_truth_sample(reference, 100, 0).vertices[:4], row.vertices)


def test_map_errors_by_hand():
    weights = np.array([1.0, 1, 2, 4])
    reference = np.array([[1, 1, 0, 0], [0, 0, 0, 1]], bool)
    maps = np.array([[1, 1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 1], [0, 0, 0, 0]], bool)
    none = np.zeros((4, 2), bool)
    np.testing.assert_allclose(
        closest_map_error(maps, reference, weights, none), np.array([0, 1, 2, 2]) / 8, atol=1e-12
    )
    excluded = none.copy()
    excluded[0, 0] = True
    excluded[1] = True
    found = closest_map_error(maps, reference, weights, excluded)
    assert found[0] == pytest.approx(6 / 8)
    assert np.isnan(found[1])


def test_map_errors_against_brute_force():
    rng = np.random.default_rng(0)
    maps, reference, weights = rng.random((5, 40)) < 0.3, rng.random((9, 40)) < 0.3, rng.random(40)
    expected = [min(weights[m != r].sum() for r in reference) / weights.sum() for m in maps]
    np.testing.assert_allclose(closest_map_error(maps, reference, weights, np.zeros((5, 9), bool)), expected)


def test_recorded_hands_lie_about_the_mesh_as_in_the_store(tiny_dataset, hand):
    """Moved to the world by hand, they are where the store says."""
    store = FramesStore.load(tiny_dataset / "frames")
    mesh = load_mesh(tiny_dataset / OBJECT_MESHES / "block.ply")
    hands = recorded_hands(store, hand, "block", mesh)
    frames = store.frames.select(store.frames.object == store.objects.index("block"))
    world = hand(frames.hand(), store.v_template[frames.subject]).vertices.numpy()
    rotation = axis_angle_to_matrix(frames.object_orient).numpy()
    back = np.einsum("nij,nvj->nvi", rotation, hands.vertices - mesh.centroid)
    np.testing.assert_allclose(back, world, atol=1e-6)
    np.testing.assert_array_equal(hands.sequences, frames.sequence)
    assert len(recorded_hands(store, hand, "block", mesh, 7)) == 7


def test_same_sequence_of_made_grasps_is_none():
    reference = random_hands(0, 4, [0, 0, 1, 1])
    assert not same_sequence(random_hands(1, 3), reference).any()
    np.testing.assert_array_equal(same_sequence(reference.select(slice(2)), reference), [[1, 1, 0, 0]] * 2)
