"""Several protocols of single grasps against closed forms and each other."""

from __future__ import annotations

import numpy as np

from grabnet.evaluation.hands import HandLabels, Hands
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.protocols.contact import FingerContact
from grabnet.evaluation.protocols.contact_maps import ContactMaps
from grabnet.evaluation.protocols.grasptta import GraspTTA
from grabnet.evaluation.protocols.ground_truth import ClosestHand
from grabnet.evaluation.protocols.halo import Halo
from grabnet.evaluation.protocols.penetration import Penetration
from grabnet.evaluation.protocols.posture import Posture
from tests.evaluation.shapes import EPSILON, ball, moved, posed, scene


def test_two_balls():
    """Volume of a lens, depth along the line of centres, contact below and above the protocols' reach."""
    r, gap = 0.03, np.array([0.04, 0.055, 0.0645, 0.0655])
    found = moved(ball(r), *[(d, 0, 0) for d in gap])
    of = scene(ball(r), found)
    lens = np.where(gap < 2 * r, np.pi * (4 * r + gap) * (2 * r - gap) ** 2 / 12, 0)
    halo = Halo()(of)
    np.testing.assert_allclose(halo["volume"], 1e6 * lens, rtol=0.02)
    np.testing.assert_allclose(halo["depth"], 100 * np.maximum(2 * r - gap, 0), atol=0.01)
    np.testing.assert_array_equal(halo["contact"], gap < 2 * r)
    coarse = GraspTTA()(of)
    np.testing.assert_array_equal(coarse["contact"], gap < 2 * r + 0.005)
    np.testing.assert_allclose(coarse["volume"], 1e6 * lens, atol=1.0)  # eight voxels
    np.testing.assert_allclose(coarse["volume"] / 0.125, np.round(coarse["volume"] / 0.125), atol=1e-9)
    depth = Penetration()(of)
    np.testing.assert_allclose(depth["max"], 10 * halo["depth"])


def all_protocols(labels: HandLabels) -> list[PerGrasp]:
    return [
        Halo(),
        GraspTTA(),
        Penetration(),
        FingerContact(labels, EPSILON),
        Posture(labels),
        ContactMaps(labels, EPSILON),
        ClosestHand(),
    ]


def test_a_hand_far_away_or_a_hundredth_of_its_size_gives_zeros(hand, labels):
    flat = posed(hand)
    reference = Hands(vertices=flat.vertices, faces=flat.faces, sequences=np.array([0]))
    far = Hands(vertices=flat.vertices + np.float32(1), faces=flat.faces, hand_pose=flat.hand_pose)
    away = 0.01 * (flat.vertices - flat.vertices.mean(1, keepdims=True)) + np.float32([0.06, 0, 0])
    tiny = Hands(vertices=away.astype(np.float32), faces=flat.faces, hand_pose=flat.hand_pose)
    for hands in (far, tiny):
        of = scene(ball(0.03), hands, reference)
        for protocol in all_protocols(labels):
            found = protocol(of)
            for name, values in found.items():
                if protocol.name not in ("posture", "table2"):
                    assert not values.any(), (protocol.name, name)
                assert np.isfinite(values).all()


def test_each_grasp_is_measured_by_itself(hand, labels):
    """In any order and in any company the same numbers, to the bit."""
    rng = np.random.default_rng(0)
    flat = posed(hand, 5, index_mcp_flexion=0.6, thumb_mcp=0.4)
    offsets = rng.normal((0.1, 0.03, 0), 0.02, (5, 1, 3))
    vertices = (flat.vertices + offsets).astype(np.float32)
    hands = Hands(vertices=vertices, faces=flat.faces, hand_pose=flat.hand_pose, sequences=np.arange(5))
    order = np.array([3, 1, 4])
    for protocol in all_protocols(labels):
        together, apart = (protocol(scene(ball(0.04), some, hands)) for some in (hands, hands.select(order)))
        for name in together:
            np.testing.assert_array_equal(together[name][order], apart[name])
    assert ContactMaps(labels, EPSILON)(scene(ball(0.04), hands))["object"].any()
