"""Protocols `walls` and `volco`: hands that a wall cuts apart, and balls and boxes, whose overlap has closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import trimesh

from grabnet.evaluation.hands import Hands
from grabnet.evaluation.protocols.volco import Volco
from grabnet.evaluation.protocols.walls import Walls
from grabnet.evaluation.reporting import published
from grabnet.geometry.mesh import Mesh
from tests.evaluation.shapes import ball, moved, posed, scene


@pytest.fixture(scope="module")
def protocols(hand) -> tuple[Walls, Volco]:
    return Walls(hand), Volco(hand)


def wall(hands: Hands, labels, offset: float) -> Mesh:
    """3 mm thick, across the middle finger, so far from its tip."""
    tip = hands.vertices[0, labels.anatomy.tips[2]]
    knuckle = (labels.joint_regressor[5] @ torch.from_numpy(hands.vertices[0])).numpy()
    along = (tip - knuckle) / np.linalg.norm(tip - knuckle)
    box = trimesh.creation.box((0.05, 0.05, 0.003))
    box.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), along))
    return Mesh(box.vertices + tip + offset * along, box.faces).subdivided().subdivided().subdivided()


def test_a_finger_through_a_wall_is_shallow_and_pierced(hand, labels, protocols):
    flat = posed(hand)
    walls, volco = (protocol(scene(wall(flat, labels, -0.012), flat)) for protocol in protocols)
    assert walls["pierced"] == [1] and walls["through"][0] > 4
    assert volco["pierce_free"] == [0] and volco["contact"] == [1]
    assert 0 < volco["depth"][0] <= 0.15 + 1e-6  # cm: what depth alone says
    walls, volco = (protocol(scene(wall(flat, labels, 0.0008), flat)) for protocol in protocols)
    assert walls["pierced"] == [0] and 0 < walls["through"][0] < 2
    assert volco["pierce_free"] == [1] and 0 < volco["volume"][0] < 0.1


def test_of_hands_of_other_vertices_bones_are_unknown(protocols):
    """Two balls one in the other by a cap of known volume; a rod that a thin plate cuts in two."""
    walls, volco = (
        protocol(scene(ball(0.03), moved(ball(0.02), (0.045, 0, 0), (0.2, 0, 0)))) for protocol in protocols
    )
    assert np.isnan(walls["through"]).all() and walls["pierced"].tolist() == [0, 0]
    r, s, d = 3.0, 2.0, 4.5
    lens = math.pi * (r + s - d) ** 2 * (d**2 + 2 * d * (r + s) - 3 * (r - s) ** 2) / (12 * d)
    assert volco["volume"] == pytest.approx([lens, 0], rel=0.03)
    assert volco["depth"] == pytest.approx([0.5, 0], rel=0.02)
    assert volco["contact"].tolist() == [1, 0]
    assert volco["contact_area"][0] > 0 == volco["contact_area"][1]

    rod = trimesh.creation.cylinder(0.005, 0.08, sections=24).subdivide().subdivide()
    plate = trimesh.creation.box((0.05, 0.05, 0.002))
    made = moved(Mesh(rod.vertices, rod.faces), (0, 0, 0), (0, 0, 0.0405))
    walls, volco = (protocol(scene(Mesh(plate.vertices, plate.faces), made)) for protocol in protocols)
    assert walls["pierced"].tolist() == [1, 0]
    assert volco["pierce_free"].tolist() == [0, 1]


def test_published_rows_are_of_metrics_that_are_measured(hand, labels):
    titles = {metric.title for metric in Volco.metrics}
    titles |= {f"volco/{name}" for name in ("displacement", "entropy", "cluster_size")}
    rows = {work: marks for work, marks in published.BY_OTHERS.items() if any("volco" in title for title in marks)}
    assert len(rows) == 7
    assert all(marks.keys() <= titles for marks in rows.values())
    assert rows["VolCoDiff"]["volco/contact_area"] == 31.1
    assert "volco/entropy" not in rows["VolCoDiff, HO-3D objects"]
