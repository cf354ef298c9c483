"""The four frames of a placement, against matrices written out by hand."""

import numpy as np
import pytest
import torch
import trimesh

from grabnet.body.hand import HandModel, HandParameters
from grabnet.generation.placement import Placement
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.conventions import Conventions
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.object_mesh import ObjectMesh
from grabnet.geometry.rotations import axis_angle_to_matrix, random_rotations
from grabnet.geometry.sdf_grid import SDFGrid

# Millimetres, y up, off the origin.
TO_OBJECT = np.array([[0.001, 0, 0, 0.05], [0, 0, -0.001, 0.02], [0, 0.001, 0, -0.01], [0, 0, 0, 1]])
WAYS = torch.tensor([0, 1, 2, 0, 1])


@pytest.fixture(scope="module")
def placed() -> ObjectMesh:
    solid = trimesh.creation.box((40, 70, 50)).subdivide().subdivide([0, 1, 2])  # its mean vertex is not its middle
    return ObjectMesh(Mesh(solid.vertices + np.array([300, -200, 100]), solid.faces), TO_OBJECT)


@pytest.fixture(scope="module", params=["mean_vertex", "box"])
def conventions(request) -> Conventions:
    return Conventions(centre=request.param)


@pytest.fixture(scope="module")
def origin(placed, conventions) -> np.ndarray:
    vertices = placed.solid.vertices.astype(float)
    return vertices.mean(0) if conventions.centre == "mean_vertex" else (vertices.min(0) + vertices.max(0)) / 2


@pytest.fixture(scope="module", params=["right", "left"])
def placement(request, placed, conventions) -> Placement:
    return Placement.of(placed, random_rotations(3, torch.Generator().manual_seed(0)), request.param, conventions)


@pytest.fixture(scope="module")
def hands() -> HandParameters:
    generator = torch.Generator().manual_seed(1)
    pose = axis_angle_to_matrix(0.3 * torch.randn(5, 15, 3, generator=generator))
    return HandParameters(random_rotations(5, generator), pose, 0.05 * torch.randn(5, 3, generator=generator))


def homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], -1)


def test_transforms_lead_from_the_mesh_to_the_world(placement, placed, origin):
    """Scaled, turned to z up, shifted about the centre, turned."""
    transforms = placement.transforms(WAYS).double().numpy()
    mesh = placed.mesh.vertices.astype(float)
    in_object = (homogeneous(mesh) @ TO_OBJECT.T)[:, :3]
    mirror = np.diag([1.0, 1, 1] if placement.mirror[0, 0] > 0 else [-1.0, 1, 1])
    for way, transform in zip(WAYS.tolist(), transforms, strict=True):
        # A left hand's world is turned the other way round: it is the mirror image of the networks'.
        turn = mirror @ placement.turns[way].double().numpy() @ mirror
        expected = (in_object - origin) @ turn.T
        np.testing.assert_allclose((homogeneous(mesh) @ transform.T)[:, :3], expected, atol=2e-6)


def test_hands_keep_their_place_on_the_object(placement, placed, hands, hand):
    """From mesh back to the world by `transforms`, and through the mirror, they are where they came from."""
    parameters, vertices = placement.hands_to_mesh(hands, WAYS, hand, hand.v_template)
    in_mesh = vertices.double().numpy() / placement.scale
    world = np.einsum("nij,nvj->nvi", placement.transforms(WAYS).double().numpy(), homogeneous(in_mesh))[..., :3]
    expected = (hand(hands).vertices @ placement.mirror).double().numpy()
    np.testing.assert_allclose(world, expected, atol=2e-6)
    model = hand if placement.mirror[0, 0] > 0 else HandModel.open("left")
    torch.testing.assert_close(model(parameters).vertices, vertices, atol=1e-5, rtol=0)


def test_points_go_to_the_object_frame(placement, placed):
    metres = torch.tensor(placed.mesh.vertices * 0.001)
    expected = torch.tensor(placed.solid.vertices)
    torch.testing.assert_close(placement.to_object_frame(metres), expected, atol=1e-6, rtol=0)


def test_objects_stand_where_the_hands_see_them(placement, placed):
    """Distances in the right-hand world are those of the box there, mirrored for a left hand."""
    objects = placement.objects(SDFAtlas([SDFGrid.build(placed.solid)])).select(WAYS)
    assert len(objects) == 5
    inside = torch.tensor(placed.solid.bounds.mean(0)) + torch.tensor([0.015, 0.0, 0.01])  # 5 mm below the surface in x
    world = (objects.rotations @ (inside - objects.centres).unsqueeze(-1)).mT
    torch.testing.assert_close(objects.distances(world), torch.full((5, 1), -0.005), atol=2e-4, rtol=0)
    # A reflection for left hands, a rotation for right ones.
    torch.testing.assert_close(torch.linalg.det(objects.rotations), placement.mirror[0, 0].expand(5))
