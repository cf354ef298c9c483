"""Networks: sizes and wiring as in ref. 6, gradients that stay finite, weights that survive the disk."""

import pytest
import torch
from torch.nn import functional as F

from grabnet.body.hand import HandModel, HandParameters
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.geometry.rotations import axis_angle_to_matrix, random_rotations
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.layers import ResidualBlock
from grabnet.models.refinenet import RefineNet
from grabnet.models.weights import load_network, read_provenance, save_network


def millions(network: torch.nn.Module) -> float:
    return round(sum(p.numel() for p in network.parameters()) / 1e6, 2)


def hands(batch: int, seed: int = 0) -> HandParameters:
    generator = torch.Generator().manual_seed(seed)
    pose = axis_angle_to_matrix(0.3 * torch.randn(batch, 15, 3, generator=generator))
    transl = 0.05 * torch.randn(batch, 3, generator=generator)
    return HandParameters(random_rotations(batch, generator), pose, transl)


def small_coarsenet() -> CoarseNet:
    torch.manual_seed(0)
    return CoarseNet(BPS(64), latent_dim=4, width=32, n_hidden=16)


def test_parameter_counts_are_the_published(hand):
    assert millions(CoarseNet(BPS(4096))) == pytest.approx(14.04, abs=0.011)
    assert millions(RefineNet(hand)) == pytest.approx(3.26, abs=0.011)


@pytest.mark.parametrize(("n_in", "n_out"), [(6, 6), (6, 9)])
def test_residual_block_is_its_formula(n_in, n_out):
    torch.manual_seed(1)
    block = ResidualBlock(n_in, n_out, 5).double()
    for norm in (block.bn1, block.bn2):  # in training, batch norm standardises over the batch
        torch.nn.init.uniform_(norm.weight)
        torch.nn.init.uniform_(norm.bias)
    x = torch.randn(8, n_in, dtype=torch.float64)

    def lrelu(t):
        return torch.where(t > 0, t, 0.2 * t)

    def norm(t, layer):
        return (t - t.mean(0)) / (t.var(0, correction=0) + layer.eps).sqrt() * layer.weight + layer.bias

    y = norm(lrelu(norm(x @ block.fc1.weight.T + block.fc1.bias, block.bn1)) @ block.fc2.weight.T + block.fc2.bias,
             block.bn2)  # fmt: skip
    skip = x if n_in == n_out else lrelu(x @ block.fc3.weight.T + block.fc3.bias)
    torch.testing.assert_close(block(x), lrelu(skip + y))


def test_coarsenet_decodes_rotations_and_repeats_by_seed():
    network = small_coarsenet().eval()
    bps = torch.rand(5, 64)
    one, two = (network.decode(torch.randn(5, 4, generator=torch.Generator().manual_seed(3)), bps) for _ in range(2))
    for a, b in zip(one, two, strict=True):
        torch.testing.assert_close(a, b)
    rotations = one.rotations
    torch.testing.assert_close(rotations @ rotations.mT, torch.eye(3).expand(5, 16, 3, 3), atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(5, 16))


def test_coarsenet_posterior_reacts_to_the_wrist_and_is_positive():
    network, bps, hand = small_coarsenet().eval(), torch.rand(5, 64), hands(5)
    posterior = network.encode(bps, hand.global_orient, hand.transl)
    moved = network.encode(bps, hand.global_orient, hand.transl + 0.1)
    assert (posterior.stddev > 0).all() and (posterior.mean - moved.mean).abs().max() > 1e-4


def test_refinenet_corrects_in_the_hands_own_terms(hand):
    """With its output layers at zero nothing changes; with a fixed translation it moves by that, three times."""
    torch.manual_seed(0)
    network = RefineNet(hand, width=16, n_hidden=8).eval()
    for layer in (network.pose, network.transl):
        torch.nn.init.zeros_(layer.weight)
        torch.nn.init.zeros_(layer.bias)
    start = hands(4)
    seen = []

    def distances(vertices):
        seen.append(vertices)
        return vertices[..., 0]

    for a, b in zip(network(start, distances), start, strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=0)
    network.transl.bias.data = torch.tensor([0.01, 0.0, -0.02])
    seen.clear()
    moved = network(start, distances)
    torch.testing.assert_close(moved.transl, start.transl + 3 * network.transl.bias)
    assert len(seen) == 3
    torch.testing.assert_close(seen[2] - seen[1], network.transl.bias.expand_as(seen[0]), atol=1e-5, rtol=0)


def test_refinenet_gradients_are_finite_at_the_identity(hand):
    network = RefineNet(hand, width=16, n_hidden=8)
    eye = torch.eye(3)
    start = HandParameters(eye.expand(4, 3, 3), eye.expand(4, 15, 3, 3), torch.zeros(4, 3))
    refined = network(start, lambda v: v.norm(dim=-1))
    hand(refined).vertices.sum().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in network.parameters())


def test_weights_survive_the_disk(tmp_path, hand):
    coarse, refine = small_coarsenet(), RefineNet(hand, iterations=2, width=16, n_hidden=8, dropout=0.1)
    for network in (coarse, refine):
        for name, value in network.state_dict().items():
            if "running" in name:
                value.uniform_(0.5, 1.5)  # the statistics must be saved too
    save_network(tmp_path / "coarse" / "model.safetensors", coarse, {"seed": 7})
    save_network(tmp_path / "refine.safetensors", refine, {})
    assert read_provenance(tmp_path / "coarse") == {"seed": 7}
    loaded = load_network(tmp_path / "coarse", kind="CoarseNet")
    bps, z = torch.rand(3, 64), torch.randn(3, 4)
    torch.testing.assert_close(loaded.decode(z, bps), coarse.eval().decode(z, bps))
    torch.testing.assert_close(loaded.bps.basis, coarse.bps.basis)
    again = load_network(tmp_path / "refine.safetensors", hand, "RefineNet")
    assert again.iterations == 2 and not again.training
    for a, b in zip(again(hands(3), lambda v: v[..., 1]), refine.eval()(hands(3), lambda v: v[..., 1]), strict=True):
        torch.testing.assert_close(a, b)


def test_matrices_may_be_rounded(tmp_path):
    network = small_coarsenet()
    save_network(tmp_path / "whole.safetensors", network, {})
    save_network(tmp_path / "half.safetensors", network, {}, torch.float16)
    whole, half = ((tmp_path / f"{name}.safetensors").stat().st_size for name in ("whole", "half"))
    assert half < 0.6 * whole
    loaded = load_network(tmp_path / "half.safetensors", kind="CoarseNet").state_dict()
    for name, value in network.state_dict().items():
        exact = value.dim() != 2 or name == "bps.basis"
        torch.testing.assert_close(loaded[name], value, rtol=0 if exact else 1e-3, atol=0 if exact else 1e-7)


def test_wrong_checkpoints_are_told_in_a_sentence(tmp_path, hand):
    save_network(tmp_path / "model.safetensors", small_coarsenet(), {})
    with pytest.raises(UserError, match="holds CoarseNet; it must hold RefineNet"):
        load_network(tmp_path, hand, "RefineNet")
    with pytest.raises(UserError, match=r"holds model\.safetensors"):
        load_network(tmp_path / "model.ckpt", kind="CoarseNet")
    (tmp_path / "junk.safetensors").write_bytes(b"not tensors")
    with pytest.raises(UserError, match="no readable safetensors"):
        load_network(tmp_path / "junk.safetensors", kind="CoarseNet")


def test_six_d_of_random_network_output_trains(hand: HandModel):
    """The published code turned NaN in its first epoch at rotations of 0 and π; a hundred steps from noise here."""
    torch.manual_seed(0)
    network = small_coarsenet()
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-2)
    target = hand(hands(16, seed=5)).vertices
    bps = torch.rand(16, 64)
    for _ in range(100):
        parameters, posterior = network(bps, *hands(16, seed=5)[::2])
        loss = F.l1_loss(hand(parameters).vertices, target) + 1e-3 * posterior.mean.square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert loss.isfinite() and loss < 0.03
