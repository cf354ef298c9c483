import copy

import pytest
import torch
from torch import nn

from grabnet.errors import UserError
from grabnet.models.acceleration import compile_blocks, set_matmul_precision
from grabnet.models.layers import ResidualBlock


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


def test_an_unknown_precision_is_refused():
    with pytest.raises(UserError, match="matmul_precision is 'low'; it can be highest, high, medium"):
        set_matmul_precision("low")
