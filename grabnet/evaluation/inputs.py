"""Inputs of an evaluation: hand, recorded grasps, objects and models, as the config names them."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

import numpy as np
from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.cli.progress import track
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.objects import object_files
from grabnet.errors import UserError
from grabnet.evaluation.cache import Cache
from grabnet.evaluation.config import EvaluationConfig
from grabnet.evaluation.hands import HandLabels, Hands
from grabnet.evaluation.models import EvaluatedModel, load_models
from grabnet.evaluation.recorded import recorded_hands
from grabnet.generation.config import usable_device
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.io.cache import default_cache
from grabnet.io.files import sha256
from grabnet.models.generator import SavedNetwork


class EvaluationInputs:
    """Inputs of an evaluation, as its config names them.

    Attributes:
        config: the settings.
        hand: the hand model.
        labels: what its vertices are.
        data: the data module, not set up.
        store: its frames.
        part: the store with the frames of the evaluated split only.
        training_part: the store with the frames of training only.
        files: meshes of all objects, by name.
        cache: of results.
        objects: names of those that are evaluated.
        meshes: of these, by name.
        truth: recorded grasps of these, by name.
        models: that are evaluated.

    Raises:
        UserError: data or models that are missing, or objects that are not in the split.
    """

    def __init__(self, config: EvaluationConfig):
        self.config = config
        self.hand: HandModel = instantiate(config.hand_model)
        self.labels = HandLabels.of(self.hand)
        self.data: GraspDataModule = instantiate(config.data, hand=self.hand)
        self.data.prepare_data()
        self.store = self.data.store
        self.part = self.data.part(config.split)
        self.training_part = self.data.part("train")
        self.files = object_files(self.data.objects_dir)
        self.cache = Cache(Path(config.cache_dir or default_cache()) / "evaluation")
        self.objects = self._objects()
        self.meshes: dict[str, Mesh] = {name: load_mesh(self.files[name]) for name in self.objects}
        self.truth: dict[str, Hands] = {
            name: recorded_hands(self.part, self.hand, name, mesh, config.max_ground_truth)
            for name, mesh in track(self.meshes.items(), "Posing recorded hands")
        }
        self.models: list[EvaluatedModel] = load_models(
            config.models, self.hand, config.runs, usable_device(config.device), **config.treatment
        )

    def data_for(self, network: SavedNetwork) -> GraspDataModule:
        """The data, set up, with objects shown as a network was trained to see them."""
        shown = network.conventions.shown(network.sees)
        if shown == self.data.conventions.shown(network.sees):
            data = self.data
        else:
            data = instantiate(self.config.data, hand=self.hand, **shown)
        data.setup()
        return data

    def _objects(self) -> list[str]:
        objects = self.part.shown_objects
        if unknown := [name for name in self.config.only or [] if name not in objects]:
            raise UserError(f"only names {unknown[0]}; the {self.config.split} objects are {', '.join(objects)}.")
        objects = self.config.only or objects
        if missing := [name for name in objects if name not in self.files]:
            raise UserError(f"{self.data.objects_dir} has no mesh for {', '.join(missing)}.")
        if not objects:
            raise UserError(f"{self.data.store_dir} has no grasp of a {self.config.split} object.")
        return objects

    @cached_property
    def training_objects(self) -> list[str]:
        """Names of training objects with a mesh; where objects are held out, without those that are evaluated."""
        names = self.training_part.shown_objects
        if self.data.split.by != "object":
            return [name for name in names if name in self.files]
        return [name for name in names if name in self.files and name not in self.objects]

    @cached_property
    def fingerprint(self) -> list[str]:
        """Hashes and names that tell frames, subjects, splits, objects and hand."""
        values = (getattr(self.store.frames, name) for name in self.store.frames.__dataclass_fields__)
        frames = [value.numpy() for value in values if value is not None]
        split = self.data.split
        names = [*self.store.objects, "|", split.by, *sorted(split.val), "|", *sorted(split.test)]
        meshes = [sha256(self.files[name]) for name in self.store.objects if name in self.files]
        return [sha256(*frames), sha256(self.store.v_template.numpy()), self.hand.fingerprint, *names, *meshes]

    @cached_property
    def training_keypoints(self) -> np.ndarray:
        """(M, 21, 3) of the training grasps."""

        # Where the hand is does not matter, but to rounding: always the same mesh's centroid, whatever is evaluated.
        mesh = load_mesh(self.files[min(self.files)])

        def compute() -> dict[str, np.ndarray]:
            part = self.training_part
            hands = [recorded_hands(part, self.hand, name, mesh) for name in part.shown_objects]
            return {"keypoints": np.concatenate([self.labels.keypoints(h) for h in hands])}

        return self.cache.get("keypoints", [*self.fingerprint, mesh.sha256], compute)["keypoints"]
