import dataclasses
import json

import numpy as np
import pytest
import torch
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from grabnet.body.anatomy import FINGERS
from grabnet.body.hand import HandParameters
from grabnet.contact.contacts import Contacts
from grabnet.generation.grasps import Grasps
from grabnet.geometry.mesh import Mesh
from grabnet.grasping.measures import GraspMeasures

RANKED = {"candidate", "nearest_mm", "score"}  # of grasps that were chosen from several


def made_of(distances: torch.Tensor, finger: torch.Tensor, to_object: np.ndarray | None = None) -> Grasps:
    n, v = distances.shape
    ball = trimesh.creation.icosphere(1)
    return Grasps(
        mesh=Mesh(ball.vertices, ball.faces),
        to_object=np.eye(4) if to_object is None else to_object,
        side="right",
        seed=7,
        parameters=HandParameters(torch.zeros(n, 3, 3), torch.zeros(n, 15, 3, 3), torch.zeros(n, 3)),
        betas=torch.zeros(n, 10),
        object_transform=torch.eye(4).expand(n, 4, 4),
        vertices=torch.zeros(n, v, 3),
        faces=torch.tensor([[0, 1, 2]]),
        contacts=Contacts(distances=distances, finger=finger),
        measures=GraspMeasures(
            through_mm=torch.linspace(0, 12, n),
            pierced=torch.arange(n) % 2 == 1,
            skin_contact_cm2=torch.full((n,), 20.0),
            opposition=torch.ones(n),
            crossing_mm=torch.zeros(n),
            joint_excess_deg=torch.arange(n).float(),
        ),
    )


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**31), st.integers(1, 4), st.integers(1, 40))
def test_report_counts_vertex_by_vertex(seed, n, v):
    rng = np.random.default_rng(seed)
    distances, finger = rng.normal(0.003, 0.004, (n, v)).astype(np.float32), rng.integers(-1, 5, v)
    report = made_of(torch.tensor(distances), torch.tensor(finger)).report()
    assert len(report) == n
    for i, record in enumerate(report):
        depths = [-1000 * float(d) for d in distances[i] if d < 0]
        assert record["max_penetration_mm"] == pytest.approx(max(depths, default=0), abs=1e-3)
        assert record["mean_penetration_mm"] == pytest.approx(sum(depths) / max(len(depths), 1), abs=1e-3)
        for part, name in enumerate([*FINGERS, "palm"]):
            label = part if name != "palm" else -1
            expected = sum(d < 0.0045 for d, f in zip(distances[i], finger, strict=True) if f == label)
            assert record["contact_vertices"][name] == expected
        assert (record["index"], record["seed"]) == (i, 7)


def test_a_hand_far_away_reports_zeros():
    record = made_of(torch.full((1, 5), 0.2), torch.tensor([-1, 0, 1, 2, 3])).report()[0]
    assert record["max_penetration_mm"] == record["mean_penetration_mm"] == 0
    assert not any(record["contact_vertices"].values())


def test_units_and_up_follow_the_frame():
    """A file in millimetres with y up."""
    to_object = np.array([[0.001, 0, 0, 0], [0, 0, -0.001, 0], [0, 0.001, 0, 0], [0, 0, 0, 1]])
    grasps = made_of(torch.zeros(1, 1), torch.tensor([0]), to_object)
    assert grasps.units_per_metre == pytest.approx(1000)
    np.testing.assert_allclose(grasps.up, (0, 1, 0), atol=1e-12)


def test_first_keeps_whole_grasps():
    grasps = made_of(torch.randn(5, 4), torch.tensor([0, 1, 2, -1]))
    few = grasps.first(2)
    assert len(few) == 2
    assert few.report() == grasps.report()[:2]
    for field in dataclasses.fields(Grasps):
        value = getattr(few, field.name)
        if isinstance(value, torch.Tensor) and field.name not in ("faces", "finger"):
            assert len(value) == 2
    assert all(len(x) == 2 for x in few.parameters)
    assert len(grasps.first(9)) == 5


def test_a_grasp_wants_the_thumb_and_another_finger():
    near, far = 0.004, 0.005
    # Vertices of thumb, index, pinky, palm.
    distances = torch.tensor(
        [[near, far, near, far], [far, near, near, near], [near, far, far, near], [-0.02, far, -0.01, 0]]
    )
    grasps = made_of(distances, torch.tensor([0, 1, 4, -1]))
    assert grasps.contacts.pinched.tolist() == [True, False, False, True]
    summary = grasps.summary()
    assert "touch in 50%, 50% go through the object" in summary
    assert "5.0 mm deep at the deepest vertex and 6.0 mm through walls" in summary


def test_each_record_has_what_the_definitions_define(tmp_path):
    grasps = made_of(torch.randn(3, 4), torch.tensor([0, 1, 2, -1]))
    grasps.save(tmp_path / "out", ())
    text = json.loads((tmp_path / "out" / "grasps.json").read_text(encoding="utf-8"))
    assert text["grasps"] == grasps.report()
    for record in text["grasps"]:
        assert set(record) - {"index", "seed"} == set(text["definitions"]) - {"distance", *RANKED}
    assert [record["through_mm"] for record in text["grasps"]] == [0, 6, 12]
    assert [record["pierced"] for record in text["grasps"]] == [False, True, False]
