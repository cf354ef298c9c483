import torch

from grabnet.body.hand import HandParameters
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.splits import Split
from grabnet.geometry.bps import BPS
from grabnet.geometry.rotations import random_rotations
from grabnet.models.coarsenet import CoarseNet
from grabnet.precision import full_precision


def test_products_are_exact_within_and_half_without():
    a, b = torch.randn(2, 8, 8, generator=torch.Generator().manual_seed(0))
    with torch.autocast("cpu", torch.bfloat16):
        exact, rough = full_precision(torch.matmul)(a, b), a @ b
    assert torch.equal(exact, a @ b)
    assert rough.dtype == torch.bfloat16


def test_hands_and_what_they_are_compared_with_are_exact_whatever_the_precision(tiny_dataset, hand, cache_dir):
    def measured(precision: str) -> tuple[torch.Tensor, ...]:
        torch.set_float32_matmul_precision(precision)
        try:
            data = GraspDataModule(
                hand, str(tiny_dataset), Split("object", ["can"], ["ring"]), cache_dir=str(cache_dir)
            )
            data.setup()
            torch.manual_seed(0)
            batch = data.assemble("train", torch.arange(40), turn=True)
            assert torch.get_float32_matmul_precision() == precision
        finally:
            torch.set_float32_matmul_precision("highest")
        return batch.vertices, batch.distances, batch.points, batch.point_distances

    for exact, found in zip(measured("highest"), measured("medium"), strict=True):
        assert torch.equal(exact, found)


def test_half_precision_stops_before_the_hand(hand):
    torch.manual_seed(0)
    network = CoarseNet(BPS(64), latent_dim=4, width=32, n_hidden=16)
    wrist, transl, bps = random_rotations(8), 0.1 * torch.randn(8, 3), torch.rand(8, 64)
    ran_in = []
    network.decoder1.register_forward_hook(lambda block, inputs, output: ran_in.append(output.dtype))
    rest = hand.v_template.expand(8, -1, 3)
    with torch.autocast("cpu", torch.bfloat16):
        guess, posterior = network(bps, wrist, transl)
        vertices = hand(guess, rest).vertices
    assert ran_in == [torch.bfloat16]
    assert {x.dtype for x in (*guess, posterior.mean, vertices)} == {torch.float32}
    identity = torch.eye(3).expand(8, 16, 3, 3)
    torch.testing.assert_close(guess.rotations @ guess.rotations.mT, identity, atol=1e-5, rtol=0)
    assert torch.equal(vertices, hand(HandParameters(*guess), rest).vertices)
    vertices.sum().backward()
    assert all(p.grad.isfinite().all() for p in network.decoder1.parameters())
