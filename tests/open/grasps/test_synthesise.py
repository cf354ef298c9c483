from __future__ import annotations

from dataclasses import replace

import pytest
import torch
import trimesh

from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.grasping.grasp_hand import GraspHand
from grabnet.grasping.proposing.grasped_object import GraspedObject, part
from grabnet.open.grasps.optimise import SynthesisDescentConfig
from grabnet.open.grasps.synthesise import GENDERS, SynthesisConfig, grasp_object, subject_betas

CONFIG = replace(
    SynthesisConfig(), per_object=10, batch=24, max_rounds=3, optimiser=SynthesisDescentConfig(iterations=45)
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> GraspedObject:
    torch.set_num_threads(1)
    ball = trimesh.creation.icosphere(4, 0.032)
    mesh = Mesh(ball.vertices, ball.faces)
    return GraspedObject("ball", mesh, [part(mesh, *mesh.bounds, 1.0, 2000, 0)], tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def found(scene, templates):
    return grasp_object(scene, templates, [2, 7], CONFIG, seed=3)


def test_a_ball_gets_its_grasps_from_both_subjects(found):
    assert len(found.kind) == CONFIG.per_object
    assert found.subject.bincount(minlength=10)[[2, 7]].tolist() == [5, 5]
    assert found.report["accepted"] > 0.3 and found.report["stable"] > 0.5


def test_contact_and_penetration_hold_by_exact_queries(found, scene, model, anatomy):
    query = MeshQuery(scene.mesh)
    betas = subject_betas(CONFIG, 3)
    for i in range(len(found.kind)):
        hand = GraspHand(model, anatomy, betas[found.subject[i]])
        vertices = hand.posed(found.pose.select(slice(i, i + 1))).vertices[0]
        distance = query.signed_distance(vertices)
        assert distance.min() > -0.0045
        assert distance[anatomy.finger == 0].min() < 0.0045
        assert distance[anatomy.finger > 0].min() < 0.0045
        torch.testing.assert_close(found.transl[i], found.pose.wrist[i] - hand.joints[0])


def test_the_seed_decides(found, scene, templates):
    few = replace(CONFIG, per_object=2, batch=8, max_rounds=1)
    again = [grasp_object(scene, templates, [2], few, seed=s) for s in (3, 3, 4)]
    for a, b in zip(again[0].pose, again[1].pose, strict=True):
        assert torch.equal(a, b)
    other = again[2].pose.wrist
    assert other.shape != again[0].pose.wrist.shape or not torch.equal(other, again[0].pose.wrist)


def test_five_women_and_five_men(model):
    lengths = []
    for betas in subject_betas(SynthesisConfig(), 0):
        rest = model.shaped(betas)
        lengths.append(float(rest[:, 0].max() - rest[:, 0].min()))
    women = [size for size, gender in zip(lengths, GENDERS, strict=True) if gender == "female"]
    men = [size for size, gender in zip(lengths, GENDERS, strict=True) if gender == "male"]
    assert len(women) == len(men) == 5
    assert sum(men) > sum(women)
    assert len({round(size, 5) for size in lengths}) == 10
