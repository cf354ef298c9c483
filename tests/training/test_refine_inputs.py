"""What RefineNet starts from and is to reach: recorded hands or a trained CoarseNet's; noise of the size asked for."""

import pytest
import roma
import torch
from hydra.utils import instantiate

from grabnet.cli.entry import compose
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.weights import load_network, save_network
from grabnet.training.refine_inputs import CoarseNetGuesses, RecordedPerturbed, SamplesPerturbed
from grabnet.training.run import train
from tests.tiny import tiny_overrides


@pytest.fixture(scope="module")
def batch(hand, tiny_dataset, cache_dir):
    data = GraspDataModule(
        hand, str(tiny_dataset), Split("object", ["can"], ["ring"]), object_points=64, cache_dir=str(cache_dir)
    )
    data.setup()
    return data.assemble("train", torch.arange(96))


def test_noise_has_the_deviations_asked_for(batch, hand):
    torch.manual_seed(0)
    made = RecordedPerturbed(finger=0.2, wrist=0.05, transl=0.004)(batch, hand)
    assert made.vertices is batch.vertices and made.hand is batch.hand
    noisy = made.noisy
    for found, true, deviation in (
        (noisy.hand_pose, batch.hand.hand_pose, 0.2),
        (noisy.global_orient, batch.hand.global_orient, 0.05),
    ):
        turn = roma.rotmat_to_rotvec(true.mT @ found)
        assert turn.square().mean().sqrt().item() == pytest.approx(deviation, rel=0.15)
    assert (noisy.transl - batch.hand.transl).std().item() == pytest.approx(0.004, rel=0.15)


def test_guesses_are_reconstructions_spread_as_asked(batch, hand, tmp_path):
    torch.manual_seed(0)
    network = CoarseNet(BPS(64), latent_dim=4, width=32, n_hidden=16).eval()
    save_network(tmp_path / "model.safetensors", network, {})
    features = network.features(batch.objects)
    with torch.no_grad():
        expected, _ = network(
            features, batch.hand.global_orient, batch.hand.transl
        )  # the posterior's mean in eval mode
    made = CoarseNetGuesses(str(tmp_path), spread=0.0)(batch, hand)
    assert made.vertices is batch.vertices and made.hand is batch.hand
    exact = made.noisy
    torch.testing.assert_close(exact.transl, expected.transl)
    torch.testing.assert_close(exact.rotations, expected.rotations)
    guesses = [CoarseNetGuesses(str(tmp_path), k)(batch, hand).noisy for k in (0.1, 1.0)]
    away = [(guess.transl - expected.transl).norm() for guess in guesses]
    assert 0 < away[0] < away[1] / 3


def test_samples_take_the_place_of_the_recorded_hands(batch, hand, tmp_path):
    network = CoarseNet(BPS(64), latent_dim=4, width=32, n_hidden=16).eval()
    save_network(tmp_path / "model.safetensors", network, {})
    source = SamplesPerturbed(str(tmp_path), finger=0.2, wrist=0.05, transl=0.004)
    torch.manual_seed(5)
    made = source(batch, hand)
    torch.manual_seed(5)
    with torch.no_grad():
        sample = network.decode(torch.randn(96, 4), network.features(batch.objects))
    torch.testing.assert_close(made.hand, sample)
    assert made.rest is batch.rest and made.objects is batch.objects and made.point_distances is None
    for k in (0, 50):
        vertices = hand(sample.select(slice(k, k + 1)), batch.rest[k]).vertices
        torch.testing.assert_close(made.vertices[k : k + 1], vertices)
        distances = batch.objects.select(slice(k, k + 1)).signed_distances(vertices)
        torch.testing.assert_close(made.distances[k : k + 1], distances)
    assert (made.vertices - batch.vertices).abs().max() > 0.01
    turn = roma.rotmat_to_rotvec(sample.hand_pose.mT @ made.noisy.hand_pose)
    assert turn.square().mean().sqrt().item() == pytest.approx(0.2, rel=0.15)
    assert (made.noisy.transl - sample.transl).std().item() == pytest.approx(0.004, rel=0.15)


def test_errors_are_those_of_the_hands_to_reach(tiny_dataset, tmp_path, cache_dir, hand):
    """A RefineNet that learns from samples is tested on samples, not on the recorded hands."""
    save_network(tmp_path / "model.safetensors", CoarseNet(BPS(64), latent_dim=4, width=32, n_hidden=16), {})
    values = ["source=samples_perturbed", f"model.source.coarsenet={tmp_path}", "trainer.max_epochs=1"]
    run = tmp_path / "run"
    cfg = compose("train", tiny_overrides(tiny_dataset, run, cache_dir, "refinenet", *values, "callbacks.grasps=null"))
    metrics = train(cfg)
    data, network = instantiate(cfg.data, hand=hand), load_network(run, hand)
    data.setup()
    source = SamplesPerturbed(str(tmp_path), finger=0.2, wrist=0.05, transl=0.004)
    to_reach, recorded = [], []
    for split, index, seed in data.loader("test"):
        batch = data.assemble(split, index)
        torch.manual_seed(seed)
        made = source(batch, hand)
        with torch.no_grad():
            vertices = hand(network(made.noisy, batch.objects.signed_distances, batch.rest), batch.rest).vertices
        to_reach += (vertices - made.vertices).norm(dim=-1).mean(-1).tolist()
        recorded += (vertices - batch.vertices).norm(dim=-1).mean(-1).tolist()
    found = metrics["test/test/v2v"] / 1000
    assert found == pytest.approx(sum(to_reach) / len(to_reach), rel=1e-3)
    assert found != pytest.approx(sum(recorded) / len(recorded), rel=1e-2)


def test_a_missing_coarsenet_is_named(tmp_path):
    with pytest.raises(UserError, match=r"source: its coarsenet must be .*nowhere"):
        CoarseNetGuesses(str(tmp_path / "nowhere"))
    with pytest.raises(UserError, match=r"source: its coarsenet must be .*nowhere"):
        SamplesPerturbed(str(tmp_path / "nowhere"), 0.2, 0.05, 0.004)
