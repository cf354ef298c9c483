"""Trained models to evaluate, as the config names them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch

from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.generation.grabber import Grabber
from grabnet.io.files import sha256


@dataclass(frozen=True)
class EvaluatedModel:
    """A trained model.

    Attributes:
        name: as the config has it.
        grabber: draws its grasps.
    """

    name: str
    grabber: Grabber

    @property
    def files(self) -> dict[str, Path]:
        """Weights files, by kind of network."""
        return self.grabber.weights

    @cached_property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of the weights files, by kind of network."""
        return {kind: sha256(path) for kind, path in self.files.items()}

    def record(self) -> dict[str, dict[str, str]]:
        """File and hash of each network, ready for JSON."""
        return {kind: {"file": str(path.resolve()), "sha256": self.hashes[kind]} for kind, path in self.files.items()}

    def title(self, part: str, among: Sequence[EvaluatedModel]) -> str:
        """A name for a variant or network of this model that no other model's has."""
        return part if len(among) == 1 else f"{self.name}: {part}"

    def variants(self) -> dict[str, Grabber]:
        """The model and parts of it that also make grasps, by name, the whole model last."""
        whole = self.grabber
        return {
            name: Grabber(part, whole.hand, whole.batch_size, whole.n_turns).to(whole.finger.device)
            for name, part in whole.generator.variants().items()
        }


def load_models(
    names: str | Sequence[str | Sequence[str]], hand: HandModel, runs: str | Path, device: torch.device
) -> list[EvaluatedModel]:
    """The models of these names, as `Grabber.from_pretrained` takes them, on a device.

    Raises:
        UserError: one that is missing, damaged, trained with another hand, or named twice.
    """
    models: list[EvaluatedModel] = []
    for name in [names] if isinstance(names, str) else names:
        # Each with a hand of its own: the data's stays on the CPU.
        grabber = Grabber.from_pretrained(name, deepcopy(hand), runs=runs).to(device)
        models.append(EvaluatedModel(name if isinstance(name, str) else " + ".join(name), grabber))
        if models[-1].name in [model.name for model in models[:-1]]:
            raise UserError(f"models names {models[-1].name} twice; name each once.")
    return models
