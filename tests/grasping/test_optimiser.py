from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from hydra.utils import instantiate
from omegaconf import OmegaConf

from grabnet.benchmarks.sample import PlainHand
from grabnet.errors import UserError
from grabnet.geometry.atlas import SDFAtlas
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.sdf_grid import AtlasConfig, SDFGrid
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.optimiser import GraspOptimiser, HoldingEnergy, OptimiserConfig
from grabnet.grasping.surface import AtlasSurface
from grabnet.io.shipped import shipped

from .conftest import poses
from .surfaces import ball

CONFIG = OptimiserConfig()


def around(hand: GraspHand, n: int = 8, seed: int = 0) -> tuple[GraspPose, torch.Tensor]:
    """Half-closed hands, and a point before their palms, which is the same for all."""
    palmar = hand.anatomy.frame[1]
    middle = hand.joints[[1, 4, 7, 10]].mean(0) + 0.035 * palmar
    generator = torch.Generator().manual_seed(seed)
    angles = torch.zeros(n, 21)
    angles[:, :16] = torch.tensor([0.5, 0, 0.6, 0.3] * 4)
    angles[:, 17] = 0.7
    angles = (angles + 0.15 * torch.randn(n, 21, generator=generator)).clamp(*hand.anatomy.angle_limits.T)
    apart = 0.01 * torch.randn(n, 3, generator=generator) @ hand.anatomy.frame
    return GraspPose(torch.eye(3).expand(n, 3, 3).contiguous(), hand.joints[0] + apart, angles), middle


def states(hand: GraspHand, pose: GraspPose, look) -> tuple[torch.Tensor, torch.Tensor]:
    """mm: depth (B,) of the deepest vertex, and distances (B, 5) of the fingers."""
    distance = 1e3 * look(hand.posed(pose).vertices)[0]
    fingers = [distance[:, hand.anatomy.finger == f].amin(1) for f in range(5)]
    return -distance.amin(1), torch.stack(fingers, 1)


def test_hands_in_a_ball_come_out_of_it_and_hold_it(hand):
    start, middle = around(hand)
    look = ball(0.03, middle)
    before, _ = states(hand, start, look)
    pose = GraspOptimiser(hand, CONFIG)(start, look, middle)
    depth, fingers = states(hand, pose, look)
    assert before.mean() > 4
    assert depth.max() < 2.5 and depth.mean() < 1.8
    assert (fingers[:, 0] < 2).all() and (fingers[:, 1:].amin(1) < 2).all()
    angles, off_axis = hand.anatomy.angles(hand.parameters(pose).hand_pose)  # as the protocol posture measures them
    low, high = hand.anatomy.angle_limits.T
    assert torch.maximum(low - angles, angles - high).max() < 1e-3 and off_axis.abs().max() < 2e-3
    torch.testing.assert_close(pose.rotation @ pose.rotation.mT, torch.eye(3).expand(8, 3, 3), atol=1e-5, rtol=0)


def test_no_iterations_leave_everything_as_it_is(hand):
    start, middle = around(hand)
    assert GraspOptimiser(hand, replace(CONFIG, iterations=0))(start, ball(0.03, middle)) is start


def test_no_hands_are_optimised_to_no_hands(hand):
    start, middle = around(hand)
    assert len(GraspOptimiser(hand, CONFIG)(start.select(slice(0)), ball(0.03, middle)).wrist) == 0


def test_a_grasp_does_not_depend_on_those_beside_it(hand):
    start, middle = around(hand)
    optimise = GraspOptimiser(hand, replace(CONFIG, iterations=15))
    together, alone = optimise(start, ball(0.03, middle)), optimise(start.select(slice(2, 3)), ball(0.03, middle))
    for ours, expected in zip(alone, together.select(slice(2, 3)), strict=True):
        torch.testing.assert_close(ours, expected, atol=1e-3, rtol=0)


@pytest.mark.parametrize("size", [-3.0, 3.0])
def test_hands_of_any_size_hold_a_ball(size, model, anatomy):
    other = GraspHand(model, anatomy, torch.tensor([size, 1.0, -1.0]))
    start, middle = around(other, n=3)
    depth, fingers = states(other, GraspOptimiser(other, CONFIG)(start, ball(0.03, middle)), ball(0.03, middle))
    assert depth.max() < 2.5
    assert (fingers[:, 0] < 2).all() and (fingers[:, 1:].amin(1) < 2).all()


def test_half_precision_around_it_changes_nothing(hand):
    start, middle = around(hand, n=2)
    optimise = GraspOptimiser(hand, replace(CONFIG, iterations=3))
    with torch.autocast("cpu", torch.bfloat16):
        inside = optimise(start, ball(0.03, middle))
    for ours, expected in zip(inside, optimise(start, ball(0.03, middle)), strict=True):
        torch.testing.assert_close(ours, expected, atol=1e-6, rtol=0)


def test_a_table_stays_under_the_hand(hand):
    start, middle = around(hand)
    look, optimise = ball(0.03, middle), GraspOptimiser(hand, CONFIG)
    free = hand.posed(optimise(start, look)).vertices[..., 2].amin(1)
    floor = float(free.mean()) + 0.01
    above = optimise(start, look, floor=floor)
    below = floor - hand.posed(above).vertices[..., 2].amin(1)
    assert (floor - free).max() > 0.01
    assert below.max() < 0.004
    assert (states(hand, above, look)[1][:, 1:].amin(1) < 2).all()


def test_how_the_model_lies_in_its_coordinates_does_not_matter(hand, turned):
    start, middle = around(hand, n=4)
    other, rotation = turned
    look, config = ball(0.03, middle), replace(CONFIG, iterations=25)
    ours, expected = energy_and_result(hand, start, look, middle, config)
    energy, vertices = energy_and_result(
        other, start._replace(rotation=start.rotation @ rotation.mT), look, middle, config
    )
    torch.testing.assert_close(energy, ours, rtol=1e-3, atol=1e-2)
    assert (vertices - expected).norm(dim=-1).mean() < 5e-4


def test_a_left_hand_does_in_the_mirror_what_a_right_hand_does(hand, left):
    start, middle = around(hand, n=4)
    mirror, config = torch.diag(torch.tensor([-1.0, 1, 1])), replace(CONFIG, iterations=25)
    ours, expected = energy_and_result(hand, start, ball(0.03, middle), middle, config)
    there = GraspPose(mirror @ start.rotation @ mirror, start.wrist @ mirror, start.angles)
    energy, vertices = energy_and_result(left, there, ball(0.03, mirror @ middle), mirror @ middle, config)
    torch.testing.assert_close(energy, ours, rtol=1e-3, atol=1e-2)
    assert (vertices @ mirror - expected).norm(dim=-1).mean() < 5e-4


def energy_and_result(hand, start, look, middle, config) -> tuple[torch.Tensor, torch.Tensor]:
    optimise = GraspOptimiser(hand, config)
    energy = HoldingEnergy(hand, config, optimise.pad_weight, start, look, middle)(start, 3.0, 1.0, 0)
    return energy, hand.posed(optimise(start, look, middle)).vertices


def box(extents: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(extents).subdivide().subdivide()


def open_box() -> trimesh.Trimesh:
    solid = box((0.06, 0.06, 0.06))
    solid.update_faces(solid.triangles_center[:, 2] < 0.0299)
    return solid


def hollow_box() -> trimesh.Trimesh:
    inner = box((0.056, 0.056, 0.056))
    inner.invert()
    return trimesh.util.concatenate([box((0.06, 0.06, 0.06)), inner])


HOSTILE = {
    "smaller than a fingertip": lambda: trimesh.creation.icosphere(2, 0.003),
    "a plate wider than the hand opens": lambda: box((0.4, 0.4, 0.01)),
    "a closed box around nothing": hollow_box,
    "a box open on one side": open_box,
    "a needle": lambda: trimesh.creation.cylinder(0.0005, 0.2, sections=8),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_objects_give_numbers(kind, hand, tmp_path):
    solid = HOSTILE[kind]()
    mesh = Mesh(np.asarray(solid.vertices, np.float32), np.asarray(solid.faces))
    look = AtlasSurface(SDFAtlas([SDFGrid.load_or_build(mesh, tmp_path, AtlasConfig(fine_nodes=20_000))]))
    anywhere = poses(6)
    start = anywhere._replace(wrist=torch.cat([0.3 * anywhere.wrist[:5], torch.zeros(1, 3)]))
    pose = GraspOptimiser(hand, replace(CONFIG, iterations=30))(start, look)
    assert all(x.isfinite().all() for x in pose)
    assert hand.posed(pose).vertices.norm(dim=-1).max() < 1


def test_the_plain_way_gives_the_same_energies_and_gradients(hand, model):
    start, middle = around(hand)
    found = []
    for kind in (GraspHand, PlainHand):
        same = kind(model, hand.anatomy, torch.zeros(10))
        angles = start.angles.clone().requires_grad_()
        optimise = GraspOptimiser(same, CONFIG)
        energy = HoldingEnergy(same, CONFIG, optimise.pad_weight, start, ball(0.03, middle))
        value = energy(start._replace(angles=angles), 2.0, 1.0, 0)
        value.sum().backward()
        found.append((value.detach(), angles.grad))
    torch.testing.assert_close(found[0][0], found[1][0], rtol=1e-4, atol=1e-2)
    torch.testing.assert_close(found[0][1], found[1][1], rtol=1e-3, atol=0.5)


def test_the_shipped_config_is_the_default():
    config = instantiate(OmegaConf.load(shipped("configs") / "shared" / "optimiser" / "default.yaml"))
    pairs = {name: tuple(getattr(config, name)) for name in ("softness", "firmness")}
    assert replace(config, **pairs) == CONFIG


@pytest.mark.parametrize(
    "values",
    [{"iterations": -1}, {"firmness": (0.0, 6.0)}, {"softness": (1.0,)}, {"contact": float("nan")}, {"memory": 1.0}],
)
def test_values_out_of_range_are_refused_in_a_sentence(values):
    with pytest.raises(UserError, match=f"{next(iter(values))} is .*; it must be"):
        OptimiserConfig(**values)
