"""What RefineNet starts from: noise of the size asked for, and a trained CoarseNet's guesses."""

import pytest
import roma
import torch

from grabnet.data.datamodule import GraspDataModule
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.weights import save_network
from grabnet.training.refine_inputs import CoarseNetGuesses, PoseNoise


@pytest.fixture(scope="module")
def batch(hand, tiny_dataset, cache_dir):
    data = GraspDataModule(
        hand, str(tiny_dataset), Split("object", ["can"], ["ring"]), object_points=64, cache_dir=str(cache_dir)
    )
    data.setup()
    return data.assemble("train", torch.arange(96))


def test_noise_has_the_deviations_asked_for(batch):
    torch.manual_seed(0)
    noisy = PoseNoise(finger=0.2, wrist=0.05, transl=0.004)(batch)
    for found, true, deviation in (
        (noisy.hand_pose, batch.hand.hand_pose, 0.2),
        (noisy.global_orient, batch.hand.global_orient, 0.05),
    ):
        turn = roma.rotmat_to_rotvec(true.mT @ found)
        assert turn.square().mean().sqrt().item() == pytest.approx(deviation, rel=0.15)
    assert (noisy.transl - batch.hand.transl).std().item() == pytest.approx(0.004, rel=0.15)


def test_guesses_are_reconstructions_spread_as_asked(batch, tmp_path):
    torch.manual_seed(0)
    network = CoarseNet(BPS(64), latent_dim=4, width=32, n_hidden=16).eval()
    save_network(tmp_path / "model.safetensors", network, {})
    features = network.features(batch.objects)
    with torch.no_grad():
        expected, _ = network(
            features, batch.hand.global_orient, batch.hand.transl
        )  # the posterior's mean in eval mode
    exact = CoarseNetGuesses(str(tmp_path), spread=0.0)(batch)
    torch.testing.assert_close(exact.transl, expected.transl)
    torch.testing.assert_close(exact.rotations, expected.rotations)
    away = [(CoarseNetGuesses(str(tmp_path), k)(batch).transl - expected.transl).norm() for k in (0.1, 1.0)]
    assert 0 < away[0] < away[1] / 3


def test_a_missing_coarsenet_is_named(tmp_path):
    with pytest.raises(UserError, match=r"model\.source\.coarsenet=.*nowhere"):
        CoarseNetGuesses(str(tmp_path / "nowhere"))
