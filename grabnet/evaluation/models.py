"""Trained models to evaluate, as the config names them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

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
        """The model and parts of it that also make grasps, as these are drawn; then the whole model with optimisation
        and with candidates, where the grabber has these. By name; the last one is the grabber itself."""
        whole = self.grabber
        plain = {
            name: whole.changed(generator=part, optimise=0, candidates=1)
            for name, part in whole.generator.variants().items()
        }
        return plain | {f"{list(plain)[-1]}{note}": grabber for note, grabber in treatments(whole).items()}


def treatments(grabber: Grabber) -> dict[str, Grabber]:
    """The grabber without its candidates, and as it is, by what that does to its grasps; only what does something."""
    treated = {}
    if grabber.optimise and grabber.candidates > 1:
        treated[", optimised"] = grabber.changed(candidates=1)
    if grabber.optimise or grabber.candidates > 1:
        treated[treatment(grabber.optimise, grabber.candidates)] = grabber
    return treated


def treatment(optimise: int, candidates: int) -> str:
    """What a grabber with these settings does to the grasps that its generator draws: ", optimised, best of 4"."""
    return ", optimised" * bool(optimise) + f", best of {candidates}" * (candidates > 1)


def load_models(
    names: str | Sequence[str | Sequence[str]], hand: HandModel, runs: str | Path, device: torch.device, **options: Any
) -> list[EvaluatedModel]:
    """The models of these names, as `Grabber.from_pretrained` takes them with these options, on a device.

    Raises:
        UserError: one that is missing, damaged, trained with another hand, or named twice.
    """
    models: list[EvaluatedModel] = []
    for name in [names] if isinstance(names, str) else names:
        # Each with a hand of its own: the data's stays on the CPU.
        grabber = Grabber.from_pretrained(name, deepcopy(hand), runs=runs, **options).to(device)
        models.append(EvaluatedModel(name if isinstance(name, str) else " + ".join(name), grabber))
        if models[-1].name in [model.name for model in models[:-1]]:
            raise UserError(f"models names {models[-1].name} twice; name each once.")
    return models
