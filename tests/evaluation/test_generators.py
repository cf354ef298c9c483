"""Generators without a network put recorded hands and templates where they belong."""

from __future__ import annotations

import numpy as np
import torch
import trimesh

from grabnet.body.anatomy import Anatomy
from grabnet.data.frames import FramesStore
from grabnet.data.objects import OBJECT_MESHES
from grabnet.evaluation.baseline import transplanted
from grabnet.evaluation.recorded import recorded_hands
from grabnet.evaluation.recorded_generator import RecordedGenerator
from grabnet.evaluation.template_generator import TemplateGenerator
from grabnet.generation.grabber import Grabber
from grabnet.geometry.mesh import Mesh, load_mesh


def test_recorded_grasps_are_those_of_the_naive_baseline_but_for_the_shape(tiny_dataset, hand, cache_dir):
    """Joints turn as recorded, and wrists lie where the baseline puts them."""
    store = FramesStore.load(tiny_dataset / "frames")
    block, can = (load_mesh(tiny_dataset / OBJECT_MESHES / f"{name}.ply") for name in ("block", "can"))
    generator = RecordedGenerator(store, hand, "block", turn=0.7)
    grasps = Grabber(generator, hand, batch_size=16, optimise=0, candidates=1)(can, 16, cache_dir=cache_dir)
    baseline = transplanted(recorded_hands(store, hand, "block", block), block, can, 0.7)
    wrists = torch.from_numpy(np.einsum("v,nvc->nc", hand.J_regressor[0].numpy(), baseline.vertices))
    drawn = hand(grasps.parameters).joints[:, 0]
    same = (grasps.parameters.hand_pose.unsqueeze(1) - torch.from_numpy(baseline.hand_pose)).abs().amax(
        (2, 3, 4)
    ) < 1e-5
    assert same.any(1).all()
    number = same.int().argmax(1)
    assert len(number.unique()) > 5
    torch.testing.assert_close(drawn, wrists[number], atol=1e-5, rtol=0)
    # The whole hand turns as the baseline's: the directions from wrist to knuckles are the same.
    knuckles = torch.from_numpy(np.einsum("jv,nvc->njc", hand.J_regressor[[1, 4, 7, 10]].numpy(), baseline.vertices))
    expected = torch.nn.functional.normalize(knuckles[number] - wrists[number].unsqueeze(1), dim=-1)
    found = torch.nn.functional.normalize(hand(grasps.parameters).joints[:, [1, 4, 7, 10]] - drawn.unsqueeze(1), dim=-1)
    assert ((expected * found).sum(-1) > 0.99).all()


def test_templates_are_put_around_an_object_that_lies_off_its_origin(hand, cache_dir):
    """Without a network, thumb and fingers of most hands come to either side of a can."""
    torch.set_num_threads(1)
    tips = Anatomy.of(hand).tips
    solid = trimesh.creation.cylinder(0.025, 0.12)
    solid.apply_translation((0.3, -0.2, 0.1))
    mesh = Mesh(solid.vertices, solid.faces)
    generator = TemplateGenerator(mesh, hand, cache_dir)
    grabber = Grabber(generator, hand, batch_size=48, optimise=0, candidates=1)
    grasps = grabber(mesh, 48, seed=1, cache_dir=cache_dir)
    tips = grasps.vertices[:, tips] - torch.tensor([0.3, -0.2, 0.1])
    assert (tips.norm(dim=-1).amin(1) < 0.09).all()
    apart = (tips[:, 0] - tips[:, 1:3].mean(1)).norm(dim=-1)
    assert (apart > 0.02).float().mean() > 0.7
    again = grabber(mesh, 12, seed=1, cache_dir=cache_dir)
    assert torch.equal(again.vertices, grasps.vertices[:12])
    other = grabber(mesh, 12, seed=2, cache_dir=cache_dir)
    assert not torch.equal(other.vertices, again.vertices)
