"""Protocol `reconstruction` (paper 4; ref. 8): how well the networks give true grasps back.

`v2v` is the mean Euclidean distance between the vertices of a true hand and its reconstruction, `v2v_mae` the mean
absolute difference of their coordinates, mm. CoarseNet reconstructs each grasp from its posterior's mean; RefineNet
from what the config's `source` makes of it. Means are over all frames of a split or of one of its objects.

`published_v2v` and `published_v2v_mae` follow the released evaluation: CoarseNet reconstructs from a sample of its
posterior, and the true hand and its reconstruction both have the model's mean shape, whoever the subject.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Self

import numpy as np
import torch
from hydra.utils import instantiate

from grabnet.body.hand import HandModel, HandParameters
from grabnet.cli.progress import track
from grabnet.data.batches import GraspBatch
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.splits import SPLITS
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import ALL, Metric, Section
from grabnet.evaluation.models import EvaluatedModel
from grabnet.evaluation.protocol import PerNetwork, Score
from grabnet.io.files import sha256
from grabnet.models.weights import check_conventions, check_hand, load_network
from grabnet.training.modules import (
    mean_shaped,
    reconstructed,
    reconstructed_from_sample,
    reconstruction_errors,
    refined,
)

_SECTION = Section(
    "Reconstruction",
    "CoarseNet reconstructs from its posterior's mean, RefineNet from disturbed true grasps. v2v is the mean Euclidean "
    "distance of vertices, v2v_mae the mean |Δ| per coordinate. published_v2v and published_v2v_mae: by the released "
    "evaluation's protocol, from a sample of the posterior and with the mean hand shape for every subject.",
)

_ERRORS = ("v2v", "v2v_mae", "published_v2v", "published_v2v_mae")
# Networks that give true grasps back.
_NETWORKS = {"CoarseNet", "RefineNet"}


@dataclass(frozen=True)
class Reconstructor:
    """How a network gives true grasps back.

    Attributes:
        prepare: makes the hands to start from and to reach.
        own: hands like the true ones, as well as the network can.
        published: hands like the true ones, as the released evaluation makes them.
    """

    prepare: Callable[[GraspBatch], GraspBatch]
    own: Callable[[GraspBatch], HandParameters]
    published: Callable[[GraspBatch], HandParameters]

    def errors(self, batch: GraspBatch, hand: HandModel) -> np.ndarray:
        """(B, 4) `_ERRORS` of a batch, mm."""
        found = []
        for reconstruct, recorded in ((self.own, batch), (self.published, mean_shaped(batch, hand))):
            task = self.prepare(recorded)
            vertices = hand(reconstruct(task), task.rest).vertices
            found += [error.double() for error in reconstruction_errors(vertices, task.vertices).values()]
        return np.stack(found, 1)


class Reconstruction(PerNetwork):
    """Errors of the evaluation's networks, cached by their weights and the data."""

    name = "reconstruction"
    metrics = tuple(
        Metric("reconstruction", name, "mm", about, "lower", section=_SECTION, per_grasp=False)
        for name, about in (
            ("v2v", "mean Euclidean distance between vertices of a true hand and of its reconstruction"),
            ("v2v_mae", "mean absolute difference of their coordinates"),
            ("published_v2v", "v2v from a sample of the posterior, all hands in the model's mean shape"),
            ("published_v2v_mae", "v2v_mae from a sample of the posterior, all hands in the model's mean shape"),
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
                    for name, (data, reconstructor) in networks
                    for score in reconstruction(data, inputs.hand, {name: reconstructor})
                ]

            sources = [*model.hashes.values(), settings, *trained_from, *inputs.fingerprint]
            for score in inputs.cache.get_json("reconstruction", sources, compute):
                scores.append(Score(**score | {"network": model.title(score["network"], among=inputs.models)}))
        return scores


def _networks(inputs: EvaluationInputs, model: EvaluatedModel) -> dict[str, tuple[GraspDataModule, Reconstructor]]:
    """Those networks of a model that give true grasps back, each with the data as it knows them.

    Raises:
        UserError: RefineNet's source is a network that was trained to see objects otherwise than it.
    """
    networks: dict[str, tuple[GraspDataModule, Reconstructor]] = {}
    loaded = {kind: load_network(file, inputs.hand, kind) for kind, file in model.files.items()}
    if "CoarseNet" in loaded:
        coarse = loaded["CoarseNet"]
        reconstructor = Reconstructor(
            prepare=lambda batch: batch,
            own=lambda batch: reconstructed(coarse, batch)[0],
            published=lambda batch: reconstructed_from_sample(coarse, batch),
        )
        networks["CoarseNet"] = inputs.data_for(coarse), reconstructor
    if "RefineNet" in loaded:
        source, data = instantiate(inputs.config.source), inputs.data_for(loaded["RefineNet"])
        for path in source.trained_from.values():
            check_hand(path, inputs.hand)
        check_conventions(source.trained_from, data.conventions)

        def refine(batch: GraspBatch) -> HandParameters:
            return refined(loaded["RefineNet"], batch.noisy, batch)

        reconstructor = Reconstructor(lambda batch: source(batch, inputs.hand), own=refine, published=refine)
        networks["RefineNet"] = data, reconstructor
    return networks


@torch.no_grad()
def reconstruction(data: GraspDataModule, hand: HandModel, networks: Mapping[str, Reconstructor]) -> Iterator[Score]:
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
        for numbers in track(data.loader(split), f"Reconstruction ({split})"):
            objects.append(data.frames(split).object[numbers[1]].numpy())
            for name, network in networks.items():
                batch = data.on_after_batch_transfer(numbers, 0)  # seeds, too
                errors[name].append(network.errors(batch, hand))
        object_of = np.concatenate(objects)
        for name, pieces in errors.items():
            values = np.concatenate(pieces)
            yield _score(name, split, ALL, values)
            for number in np.unique(object_of):
                yield _score(name, split, data.store.objects[number], values[object_of == number])


def _score(network: str, split: str, object_name: str, values: np.ndarray) -> Score:
    """Args: values: (N, 4) `_ERRORS` of frames."""
    means = dict(zip(_ERRORS, values.mean(0).tolist(), strict=True))
    return Score(network, split, object_name, means, len(values))
