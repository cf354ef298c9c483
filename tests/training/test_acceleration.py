import copy

import pytest
import torch
from torch import nn

from grabnet.errors import UserError
from grabnet.models.layers import ResidualBlock
from grabnet.training.acceleration import compile_blocks, denormals_flushed, set_matmul_precision


def test_compiled_blocks_give_the_same_under_the_same_names():
    torch.manual_seed(0)
    plain = nn.ModuleList([nn.Linear(3, 3), ResidualBlock(3, 4, 2)])
    compiled = copy.deepcopy(plain)
    compile_blocks(compiled)
    torch._dynamo.reset()  # of what other tests compiled: torch compiles a function for a few kinds of input only
    torch._dynamo.utils.counters.clear()
    x = torch.randn(6, 3)
    with torch.no_grad():  # compiling the gradient as well would take a test of half a minute
        outputs = [network[1](network[0](x)) for network in (plain, compiled)]
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] == 1
    torch.testing.assert_close(*outputs)
    torch.testing.assert_close(compiled.state_dict(), plain.state_dict())  # names and running statistics


def test_every_block_of_many_is_compiled_in_training_and_outside_it(monkeypatch):
    monkeypatch.setattr(torch._dynamo.config, "recompile_limit", 8)  # torch's own
    blocks = nn.ModuleList([ResidualBlock(n, 4, 2) for n in range(5, 10)])
    compile_blocks(blocks)
    torch._dynamo.reset()
    torch._dynamo.utils.counters.clear()
    with torch.compiler.set_stance("default", force_backend="eager"):
        for training in (True, False):
            for block in blocks.train(training):
                block(torch.randn(6, block.fc1.in_features))
    assert torch._dynamo.utils.counters["stats"]["unique_graphs"] == 2 * len(blocks)


def test_denormals_are_zero_within_and_numbers_again_after():
    factors = torch.full((3,), 1e-20), torch.full((3,), 1e-19)
    with denormals_flushed():
        assert not torch.mul(*factors).any()
    assert torch.mul(*factors).all()


def test_an_unknown_precision_is_refused():
    with pytest.raises(UserError, match="matmul_precision is 'low'; it can be highest, high, medium"):
        set_matmul_precision("low")
