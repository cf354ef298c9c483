"""Protocol `reconstruction` (paper 4; ref. 8): how well the networks give true grasps back.

`v2v` is the mean Euclidean distance between the vertices of a true hand and its reconstruction, `v2v_mae` the mean
absolute difference of their coordinates, mm. CoarseNet reconstructs each grasp from its posterior's mean; RefineNet
mends a disturbed copy of it. Means are over all frames of a split or of one of its objects.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from typing import Self

import numpy as np
import torch
from hydra.utils import instantiate
from rich.progress import track

from grabnet.body.hand import HandModel, HandParameters
from grabnet.data.batches import GraspBatch
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.splits import SPLITS
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import ALL, Metric, Section
from grabnet.evaluation.models import EvaluatedModel
from grabnet.evaluation.protocol import PerNetwork, Score
from grabnet.io.files import sha256
from grabnet.models.weights import check_conventions, load_network
from grabnet.training.modules import reconstructed, reconstruction_errors, refined

_SECTION = Section(
    "Reconstruction",
    "CoarseNet reconstructs from its posterior's mean, RefineNet from disturbed true grasps. v2v is the mean Euclidean "
    "distance of vertices, v2v_mae the mean |Δ| per coordinate, which is what was published.",
)

# Those that give true grasps back.
_NETWORKS = {"CoarseNet", "RefineNet"}
# From a batch to hands like its true ones.
Reconstruct = Callable[[GraspBatch], HandParameters]


class Reconstruction(PerNetwork):
    """Errors of the evaluation's networks, cached by their weights and the data."""

    name = "reconstruction"
    metrics = tuple(
        Metric("reconstruction", name, "mm", about, "lower", section=_SECTION, per_grasp=False)
        for name, about in (
            ("v2v", "mean Euclidean distance between vertices of a true hand and of its reconstruction"),
            ("v2v_mae", "mean absolute difference of their coordinates"),
        )
    )

    def __init__(self, inputs: EvaluationInputs):
        self.inputs = inputs

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self | None:
        any_network = any(_NETWORKS & model.files.keys() for model in inputs.models)
        return cls(inputs) if inputs.config.reconstruction and any_network else None

    def __call__(self) -> list[Score]:
        inputs, scores = self.inputs, []
        settings = json.dumps([inputs.config.source, inputs.config.data], sort_keys=True)
        trained_from = [sha256(file) for file in instantiate(inputs.config.source).trained_from.values()]
        for model in inputs.models:

            def compute(model: EvaluatedModel = model) -> list[dict]:
                networks = _networks(inputs, model).items()
                return [
                    asdict(score)
                    for name, (data, reconstruct) in networks
                    for score in reconstruction(data, inputs.hand, {name: reconstruct})
                ]

            sources = [*model.hashes.values(), settings, *trained_from, *inputs.fingerprint]
            for score in inputs.cache.get_json("reconstruction", sources, compute):
                scores.append(Score(**score | {"network": model.title(score["network"], among=inputs.models)}))
        return scores


def _networks(inputs: EvaluationInputs, model: EvaluatedModel) -> dict[str, tuple[GraspDataModule, Reconstruct]]:
    """Those networks of a model that give true grasps back, each with the data as it knows them.

    Raises:
        UserError: RefineNet's source is a network that was trained to see objects otherwise than it.
    """
    networks: dict[str, tuple[GraspDataModule, Reconstruct]] = {}
    loaded = {kind: load_network(file, inputs.hand, kind) for kind, file in model.files.items()}
    if "CoarseNet" in loaded:
        networks["CoarseNet"] = (
            inputs.data_for(loaded["CoarseNet"]),
            lambda batch: reconstructed(loaded["CoarseNet"], batch)[0],
        )
    if "RefineNet" in loaded:
        source, data = instantiate(inputs.config.source), inputs.data_for(loaded["RefineNet"])
        check_conventions(source.trained_from, data.conventions)
        networks["RefineNet"] = data, lambda batch: refined(loaded["RefineNet"], source(batch), batch)
    return networks


@torch.no_grad()
def reconstruction(data: GraspDataModule, hand: HandModel, networks: Mapping[str, Reconstruct]) -> Iterator[Score]:
    """Yield scores of networks on every split and object.

    Args:
        data: set up, without a trainer. Its batches seed the disturbances, so that the figures are those of a training
            run's own test.
        hand: the hand model.
        networks: by name.
    """
    for split in SPLITS:
        errors: dict[str, list[np.ndarray]] = {name: [] for name in networks}
        objects = []
        for numbers in track(data.loader(split), f"Reconstruction ({split})", transient=True):
            objects.append(data.frames(split).object[numbers[1]].numpy())
            for name, reconstruct in networks.items():
                batch = data.on_after_batch_transfer(numbers, 0)  # seeds, too
                of_batch = reconstruction_errors(hand(reconstruct(batch), batch.rest).vertices, batch.vertices)
                errors[name].append(np.stack([of_batch["v2v"].double(), of_batch["v2v_mae"].double()], 1))
        object_of = np.concatenate(objects)
        for name, pieces in errors.items():
            values = np.concatenate(pieces)
            yield _score(name, split, ALL, values)
            for number in np.unique(object_of):
                yield _score(name, split, data.store.objects[number], values[object_of == number])


def _score(network: str, split: str, object_name: str, values: np.ndarray) -> Score:
    """Args: values: (N, 2) v2v and v2v_mae of frames."""
    means = dict(zip(("v2v", "v2v_mae"), values.mean(0).tolist(), strict=True))
    return Score(network, split, object_name, means, len(values))
