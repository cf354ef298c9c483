"""Trying a model before it is trained: that its networks can be saved, loaded and sampled."""

from __future__ import annotations

import torch

from grabnet.data.datamodule import GraspDataModule
from grabnet.errors import UserError
from grabnet.models.weights import check_savable
from grabnet.training.modules import GraspTraining


@torch.no_grad()
def rehearse(module: GraspTraining, data: GraspDataModule) -> None:
    """Save and load each network of `module` in memory, and make two grasps.

    Args:
        module: to be trained.
        data: set up.

    Raises:
        UserError: a network that could not be used after its training.
    """
    for network in module.networks.values():
        check_savable(network, module.hand)
    batch = data.assemble("train", torch.arange(2))
    name = type(module).__name__
    was_training = module.training
    try:
        with torch.random.fork_rng([]):
            vertices = module.eval().grasp(batch)
    except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise UserError(f"{name} makes no grasps: its generator, or its own grasp, fails ({reason}).") from error
    finally:
        module.train(was_training)
    if vertices.shape != batch.vertices.shape:
        expected, found = tuple(batch.vertices.shape), tuple(vertices.shape)
        raise UserError(f"{name} makes hands of shape {found}; for two objects it must be {expected}.")
