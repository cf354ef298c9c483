"""Protocol `reconstruction` (paper 4, Table of v2v errors; ref. 8): how well the networks give true grasps back.

`v2v` is the mean Euclidean distance between the vertices of a true hand and its reconstruction, `v2v_mae` the mean
absolute difference of their coordinates, mm. CoarseNet reconstructs each grasp from its posterior's mean; RefineNet
mends a disturbed copy of it. Means are over all frames of a split or of one of its objects.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from rich.progress import track

from grabnet.body.hand import HandModel, HandParameters
from grabnet.data.batches import GraspBatch
from grabnet.data.datamodule import SPLITS, GraspDataModule
from grabnet.models.weights import load_network
from grabnet.training.modules import reconstructed, reconstruction_errors, refined


class Errors(NamedTuple):
    """Mean errors in mm over n frames; object "all" for a whole split."""

    network: str
    split: str
    object: str
    v2v: float
    v2v_mae: float
    n: int


@torch.no_grad()
def reconstruction(
    data: GraspDataModule,
    hand: HandModel,
    files: Mapping[str, Path],
    source: Callable[[GraspBatch], HandParameters],
) -> Iterator[Errors]:
    """Errors of each network that gives true grasps back, on every split and object.

    Args:
        data: set up, without a trainer. Its batches seed the disturbances, so that the figures are those of a training
            run's own test.
        hand: the hand model.
        files: weights of the networks, by kind.
        source: a batch → disturbed copies of its hands, which RefineNet starts from.
    """
    networks: dict[str, Callable[[GraspBatch], HandParameters]] = {}
    if "CoarseNet" in files:
        coarsenet = load_network(files["CoarseNet"], hand, "CoarseNet")
        networks["CoarseNet"] = lambda batch: reconstructed(coarsenet, batch)[0]
    if "RefineNet" in files:
        refinenet = load_network(files["RefineNet"], hand, "RefineNet")
        networks["RefineNet"] = lambda batch: refined(refinenet, source(batch), batch)
    for split in SPLITS:
        errors: dict[str, list[np.ndarray]] = {name: [] for name in networks}
        objects = []
        for numbers in track(data.loader(split), f"Reconstruction ({split})", transient=True):
            objects.append(data.frames(split).object[numbers[1]].numpy())
            for name, predict in networks.items():
                batch = data.on_after_batch_transfer(numbers, 0)  # seeds, too
                of_batch = reconstruction_errors(hand(predict(batch), batch.rest).vertices, batch.vertices)
                errors[name].append(np.stack([of_batch["v2v"].double(), of_batch["v2v_mae"].double()], 1))
        object_of = np.concatenate(objects)
        for name, pieces in errors.items():
            values = np.concatenate(pieces)
            yield Errors(name, split, "all", *values.mean(0).tolist(), len(values))
            for number in np.unique(object_of):
                own = values[object_of == number]
                yield Errors(name, split, data.store.objects[number], *own.mean(0).tolist(), len(own))
