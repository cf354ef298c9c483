"""The shipped open hands."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grabnet.body.anatomy import FINGERS, Anatomy
from grabnet.body.hand import OPEN_HANDS, HandParameters
from grabnet.body.skeleton import HAND_JOINTS
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import boundary_loops, close
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import sha256
from grabnet.io.npz import read_npz
from grabnet.open.hand.build import mirrored

SIDES = ("RIGHT", "LEFT")


@pytest.fixture(scope="module")
def anatomy(hand):
    return Anatomy.of(hand)


def posed(hand, anatomy, angles):
    """(N, 21) angles → (N, V, 3)."""
    n = len(angles)
    return hand(HandParameters(torch.eye(3).expand(n, 3, 3), anatomy.hand_pose(angles), torch.zeros(n, 3))).vertices


def edges_of(faces):
    return torch.unique(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).sort(1)[0], dim=0).T


def lengths(vertices, faces):
    a, b = edges_of(faces)
    return (vertices[:, a] - vertices[:, b]).norm(dim=-1)


def hand_length(vertices, joints, anatomy):
    """Wrist crease to middle fingertip along the hand."""
    return joints[:, 0, 0] - vertices[:, anatomy.tips[2], 0]


# --- The shipped files ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", SIDES)
def test_file_keeps_manos_schema(side):
    path = OPEN_HANDS / f"MANO_{side}.npz"
    model = read_npz(path)
    assert path.stat().st_size < 150_000
    assert model["v_template"].shape == (778, 3)
    assert model["shapedirs"].shape == (778, 3, 10)
    assert model["f"].shape == (1538, 3)
    assert model["f"].dtype.kind == "u"
    assert not model["posedirs"].any()  # the hand model skips pose correctives that are exactly zero
    assert [len(loop) for loop in boundary_loops(model["f"])] == [16]
    for name in ("weights", "J_regressor"):
        assert (model[name] >= 0).all()
        np.testing.assert_allclose(model[name].sum(1), 1, atol=1e-5)
    components = model["hands_components"]
    np.testing.assert_allclose(components @ components.T, np.eye(45), atol=1e-5)
    assert sorted(np.unique(model["f"])) == list(range(778))


@pytest.mark.parametrize("side", SIDES)
def test_readme_names_the_hash(side):
    path = OPEN_HANDS / f"MANO_{side}.npz"
    assert sha256(path) in (OPEN_HANDS / "README.md").read_text(encoding="utf-8")


def test_left_is_the_exact_mirror_image():
    right, left = (read_npz(OPEN_HANDS / f"MANO_{side}.npz") for side in SIDES)
    for name, array in mirrored(right).items():
        np.testing.assert_array_equal(left[name], array, err_msg=name)


def test_hand_lengths_over_betas_are_those_of_adults(hand, anatomy):
    betas = torch.randn(4000, 10, generator=torch.Generator().manual_seed(0))
    rest = hand.shaped(betas)
    length = hand_length(rest, hand.rest_joints(rest), anatomy) * 1000
    assert length.mean().item() == pytest.approx(189, abs=2)
    assert length.std().item() == pytest.approx(10, abs=1.5)


def test_no_direction_explains_nearly_everything_and_fingers_vary_apart(hand, anatomy):
    energy = hand.shapedirs.square().sum((0, 1))
    assert energy[0] / energy.sum() < 0.85
    rest = hand.shaped(torch.randn(2000, 10, generator=torch.Generator().manual_seed(1)))
    joints = hand.rest_joints(rest)
    finger = [(rest[:, anatomy.tips[f]] - joints[:, HAND_JOINTS.index(f"{name}1")]).norm(dim=-1)
              for f, name in enumerate(FINGERS)]  # fmt: skip
    share = torch.stack([x / hand_length(rest, joints, anatomy) for x in finger])
    assert (share.std(1) / share.mean(1) > 0.015).all()
    assert (torch.corrcoef(share) - torch.eye(5)).max() < 0.9


def test_zero_pose_is_flat(hand, anatomy):
    joints = hand.rest_joints(hand.v_template)
    for f, finger in enumerate(FINGERS[1:], start=1):
        first = HAND_JOINTS.index(f"{finger}1")
        points = torch.cat([joints[first : first + 3], hand.v_template[anatomy.tips[f], None]])
        direction = torch.nn.functional.normalize(points.diff(dim=0), dim=-1)
        assert (direction[:, 1].abs() < 0.2).all(), "in the plane of the palm"
        assert (direction[0] @ direction[1:].T > 0.96).all(), "straight"
        assert (direction[:, 0] < -0.8).all(), "along −x"


def test_mean_pose_is_relaxed(hand, anatomy):
    """Somewhat flexed: fingertips nearer the palm than flat, far from a fist."""
    pose = axis_angle_to_matrix(hand.hands_mean.view(1, 15, 3))
    vertices = hand(HandParameters(torch.eye(3)[None], pose, torch.zeros(1, 3))).vertices[0]
    drop = hand.v_template[anatomy.tips[1:], 1] - vertices[anatomy.tips[1:], 1]
    assert (drop > 0.02).all() and (drop < 0.08).all()


def test_first_pose_component_closes_the_hand(hand, anatomy):
    """Both ways along it: one opens, the other closes all four fingers together."""
    pose = axis_angle_to_matrix(hand.pose_from_pca(torch.tensor([[1.5], [-1.5]])).view(2, 15, 3))
    vertices = hand(HandParameters(torch.eye(3).expand(2, 3, 3), pose, torch.zeros(2, 3))).vertices
    lift = vertices[:, anatomy.tips[1:], 1] - hand.v_template[anatomy.tips[1:], 1]
    assert (lift[0] * lift[1] < 0).all()
    assert lift[0].sign().abs().sum() == 4 and lift[0].sign().unique().numel() == 1


def test_skin_stays_whole_at_the_limits(hand, anatomy):
    """Every angle at each of its limits, the fist, and random poses within the limits: no spike, no flipped patch."""
    low, high = anatomy.angle_limits.T
    single = torch.cat([low.diag(), high.diag()])
    random = low + (high - low) * torch.rand(200, 21, generator=torch.Generator().manual_seed(0))
    rest = lengths(hand.v_template[None], hand.faces)
    for angles, stretch, growth in ((single, 4.5, 0.016), (fist(anatomy)[None], 2.5, 0.006), (random, 7, 0.03)):
        length = lengths(posed(hand, anatomy, angles), hand.faces)
        assert (length / rest).max() < stretch
        assert (length - rest).max() < growth
    # A spike is a vertex far from all its neighbours. Webs stretch, but each vertex keeps company.
    vertices = posed(hand, anatomy, torch.cat([single, random]))
    a, b = edges_of(hand.faces)
    apart = (vertices[:, a] - vertices[:, b]).norm(dim=-1)
    nearest = torch.full(vertices.shape[:2], torch.inf)
    for ends in (a, b):
        nearest.scatter_reduce_(1, ends.expand(len(apart), -1), apart, "amin")
    assert nearest.max() < 0.02


def test_triangles_do_not_turn_inside_out(hand, anatomy):
    """Against the bone that most of it follows, a triangle leans, but few turn over, at folds only."""
    low, high = anatomy.angle_limits.T
    angles = torch.cat([low.diag(), high.diag(), fist(anatomy)[None]])
    posed_hand = posed(hand, anatomy, angles)

    def normals(vertices):
        a, b, c = vertices[..., hand.faces, :].unbind(-2)
        return torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a, dim=-1), dim=-1)

    pose = anatomy.hand_pose(angles)
    world = [torch.eye(3).expand(len(angles), 3, 3)]
    for joint in range(1, 16):
        world.append(world[hand.parents[joint]] @ pose[:, joint - 1])
    world = torch.stack(world, 1)
    bone = hand.weights[hand.faces].sum(1).argmax(1)
    carried = (world[:, bone] @ normals(hand.v_template).unsqueeze(-1)).squeeze(-1)
    flipped = (carried * normals(posed_hand)).sum(-1) < 0
    assert flipped[:-1].float().mean(1).max() < 0.02
    assert flipped[-1].float().mean() < 0.06


def fist(anatomy):
    angles = torch.zeros(21)
    for k, name in enumerate(anatomy.angle_names):
        if not name.startswith("thumb"):
            angles[k] = {"mcp_flexion": 1.5, "pip": 1.7, "dip": 1.0}.get(name.partition("_")[2], 0)
    return angles


def test_a_fist_keeps_its_volume(hand, anatomy):
    vertices = posed(hand, anatomy, torch.stack([torch.zeros(21), fist(anatomy)]))
    flat, closed = (Mesh(*close(one.numpy(), hand.faces.numpy())).volume for one in vertices)
    assert 0.82 < closed / flat < 1.05


def test_knuckles_bend_behind_the_web(hand, anatomy):
    """At the web between two fingers the skin already follows them: the knuckles lie at least 1 cm behind it."""
    joints = hand.rest_joints(hand.v_template)
    middle, ring = (anatomy.finger == FINGERS.index(f) for f in ("middle", "ring"))
    a, b = edges_of(hand.faces)
    across = (middle[a] & ring[b]) | (ring[a] & middle[b])
    web = hand.v_template[torch.cat([a[across], b[across]])]
    assert joints[HAND_JOINTS.index("middle1"), 0] > web[:, 0].min() + 0.01


# --- The steps of the build -------------------------------------------------------------------------------------------
