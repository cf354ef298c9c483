"""Layers in several processes are checked against one process with all the rows."""

from pathlib import Path

import torch
import torch.distributed as dist
from torch import nn

from grabnet.models.layers import BatchNorm, ResidualBlock

ROWS = (4, 3)  # of the two processes


def network_and_rows() -> tuple[nn.Module, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    network = nn.Sequential(BatchNorm(5), ResidualBlock(5, 6, 4)).double()
    x, target = torch.randn(2, sum(ROWS), 5, generator=generator, dtype=torch.float64)
    return network, 3 + x, target


def two_steps(network: nn.Module, x: torch.Tensor, target: torch.Tensor) -> dict[str, torch.Tensor]:
    """Outputs, gradients of a loss summed over rows, and the state after two forward passes of different statistics."""
    x = x.clone().requires_grad_()
    network(2 * x.detach())
    out = network(x)
    (out[:, :5] * target).sum().backward()
    gradients = {f"gradient.{name}": p.grad for name, p in network.named_parameters()}
    return {"out": out.detach(), "x": x.grad} | gradients | network.state_dict()


def one_of_two(rank: int, folder: Path) -> None:
    dist.init_process_group("gloo", init_method=f"file://{folder}/meeting", rank=rank, world_size=2)
    network, x, target = network_and_rows()
    torch.save(two_steps(network, x.split(ROWS)[rank], target.split(ROWS)[rank]), folder / f"{rank}.pt")
    dist.destroy_process_group()


def test_two_processes_normalise_as_one(tmp_path):
    torch.multiprocessing.spawn(one_of_two, (tmp_path,), nprocs=2)
    parts = [torch.load(tmp_path / f"{rank}.pt", weights_only=True) for rank in range(2)]
    whole = two_steps(*network_and_rows())
    for name, expected in whole.items():
        first, second = (part[name] for part in parts)
        if name in ("out", "x"):
            torch.testing.assert_close(torch.cat([first, second]), expected)
        elif name.startswith("gradient"):
            torch.testing.assert_close(first + second, expected)
        else:
            assert torch.equal(first, second)
            torch.testing.assert_close(first, expected)
    assert (whole["0.running_mean"] - 3).abs().min() > 1  # it has moved but not arrived: the momentum counts
    assert whole["0.running_mean"].abs().min() > 0.1
