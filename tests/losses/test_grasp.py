import torch
from hydra.utils import instantiate
from torch.distributions import Normal

from grabnet.cli.entry import compose
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.splits import Split


def test_object_points_left_out_change_no_weight_of_the_others(tiny_dataset, hand, cache_dir):
    """The term of a few points is their part of the published mean over all samples."""
    places = {"root": str(tiny_dataset), "split": Split("object", ["can"], ["ring"]), "cache_dir": str(cache_dir)}

    def term(near_points):
        data = GraspDataModule(hand, near_points=near_points, **places)
        data.setup()
        batch = data.assemble("train", torch.arange(6))
        loss = instantiate(compose("train", []).model.loss)(hand=hand, contact=data.contact)
        moved = batch.vertices + torch.linspace(-0.02, 0.02, 3)
        posterior = Normal(torch.zeros(6, 4), torch.ones(6, 4))
        return loss(moved, batch, posterior)["object_to_hand"], loss, batch, moved

    whole, loss, batch, moved = term(2048)
    reached = loss.nearest.signed_offset(batch.points, moved)
    error = (reached - batch.point_distances).abs() * loss.point_weights(reached, batch.point_distances)
    error *= loss.object_to_hand * (1 - loss.kl) / error.numel()
    torch.testing.assert_close(whole, error.sum())
    nearest = batch.point_distances.abs().topk(40, largest=False).indices
    few = error.gather(1, nearest).sum()
    torch.testing.assert_close(term(40)[0], few, rtol=1e-3, atol=0)  # ties among half-precision distances
    assert few < whole
