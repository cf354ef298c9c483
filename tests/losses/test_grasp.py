"""The object→hand term of the default settings against a plain one: every sample of the object's surface counts."""

import pytest
import torch
from hydra.utils import instantiate
from torch.distributions import Normal

from grabnet.body.anatomy import vertex_normals
from grabnet.cli.entry import compose
from grabnet.data.datamodule import GraspDataModule

FRAMES = torch.arange(6)


@pytest.fixture(scope="module")
def step(tiny_dataset, hand, cache_dir):
    """Data, and the loss of the default config."""
    values = [
        f"data.root={tiny_dataset}",
        f"data.cache_dir={cache_dir}",
        "data.split.val=[can]",
        "data.split.test=[ring]",
    ]
    cfg = compose("train", ["data=frames", *values])
    data: GraspDataModule = instantiate(cfg.data, hand=hand)
    data.setup()
    return data, instantiate(cfg.model.loss)(hand=hand, contact=data.contact)


def signed(points: torch.Tensor, vertices: torch.Tensor, faces: torch.Tensor) -> torch.Tensor:
    """Distance to the nearest vertex, negative against its normal."""
    offsets = points.unsqueeze(2) - vertices.unsqueeze(1)
    distance, index = offsets.norm(dim=-1).min(2)
    offset = offsets.gather(2, index[..., None, None].expand(-1, -1, 1, 3)).squeeze(2)
    normal = vertex_normals(vertices, faces).gather(1, index.unsqueeze(-1).expand(-1, -1, 3))
    return torch.where((offset * normal).sum(-1) < 0, -distance, distance)


@pytest.mark.parametrize("away", [0.004, 0.03, 0.1])
def test_all_samples_count_wherever_the_prediction_is(step, hand, away):
    """At hands near the true ones, as reconstructions are, and at hands elsewhere on the object, as samples are."""
    data, loss = step
    batch = data.assemble("train", FRAMES)
    samples = data.assembler.object_set.points[batch.objects.index] @ batch.objects.rotations.mT
    assert samples.shape[1] == 2048
    towards = -batch.vertices.mean(1, keepdim=True)
    moved = batch.vertices + away * towards / towards.norm(dim=-1, keepdim=True)
    reached, true = (
        torch.cat([signed(*one, hand.faces) for one in zip(samples.split(1), v.split(1), strict=True)])
        for v in (moved, batch.vertices)
    )
    assert ((reached < 0) & (true > 0.005)).sum() > 20  # penetrate, though far from the true hand
    near = (true > -0.005) & (true < 0.010)
    weight = torch.where(reached < 0, 1.5, torch.where(near, 1.0, 0.1))
    expected = 30.0 * (1 - 5e-3) * ((reached - true).abs() * weight).mean()
    posterior = Normal(torch.zeros(6, 4), torch.ones(6, 4))
    found = loss(moved, batch, posterior)["object_to_hand"]
    torch.testing.assert_close(found, expected, rtol=2e-3, atol=0)  # true distances are kept in half precision
