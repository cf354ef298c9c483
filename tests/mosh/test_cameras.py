"""Which markers cameras see, against rays and triangles computed one by one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

from grabnet.errors import UserError
from grabnet.geometry.sight import Occluder
from grabnet.mosh.cameras import Rig, seen


def hides(triangles: np.ndarray, start: np.ndarray, end: np.ndarray) -> bool:
    """Whether a segment passes through a triangle (F, 3, 3), by Cramer's rule."""
    a, b, c = triangles.swapaxes(0, 1)
    matrix = np.stack([b - a, c - a, np.broadcast_to(start - end, a.shape)], -1)
    u, v, t = np.linalg.solve(matrix, (start - a)[..., None])[..., 0].T
    return bool(((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)).any())


def test_an_occluder_hides_what_is_behind_it_wherever_it_moves():
    ball = trimesh.creation.icosphere(1, 0.5)
    rng = np.random.default_rng(0)
    occluder = Occluder(torch.tensor(ball.vertices).float(), ball.faces)
    for _ in range(3):
        moved = ball.vertices * rng.uniform(0.8, 2, 3) + rng.uniform(-0.3, 0.3, 3)
        occluder.move(torch.tensor(moved))
        start, end = rng.uniform(-1.5, 1.5, (2, 60, 3))
        found = occluder.hides(torch.tensor(start), torch.tensor(end))
        expected = [hides(moved[ball.faces], a, b) for a, b in zip(start, end, strict=True)]
        assert found.tolist() == expected and 5 < sum(expected) < 55


@pytest.mark.parametrize(("cameras", "views"), [(1, 1), (7, 2), (20, 2), (20, 9)])
def test_markers_are_seen_by_as_many_cameras_as_are_asked_for(cameras, views):
    rig = Rig(cameras=cameras, views=views)
    places = rig.places(np.array([1.0, 2.0, 0.5]))
    assert places.shape == (cameras, 3) and set(np.round(places[:, 2].tolist(), 6)) <= {1.2, 2.6}
    np.testing.assert_allclose(np.hypot(*(places[:, :2].numpy() - [1, 2]).T), 3.5, rtol=1e-5)
    box = trimesh.creation.box((1, 1, 2))
    box.apply_translation((1, 2, 1))
    markers = np.array([1, 2, 1]) + np.random.default_rng(1).uniform(-0.8, 0.8, (40, 3))
    occluder = Occluder(torch.tensor(box.vertices).float(), box.faces)
    found = seen(rig, places, torch.tensor(markers).float(), occluder)
    number = [sum(not hides(box.triangles, m, c) for c in places.double().numpy()) for m in markers]
    assert found.tolist() == [n >= views for n in number] and 0 < found.sum() < 40


def test_rigs_that_cannot_be_are_refused():
    for values in ({"cameras": 0}, {"radius": 0}, {"cameras": 2, "views": 3}, {"heights": []}, {"marker": -1}):
        with pytest.raises(UserError, match=r"^rig\."):
            Rig(**values)
