"""What is evaluated on and what is evaluated: hand, true grasps, objects and networks, as the config names them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from hydra.utils import instantiate

from grabnet.body.hand import HandModel
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.objects import object_files
from grabnet.errors import UserError
from grabnet.evaluation.cache import Cache
from grabnet.evaluation.hands import HandLabels, Hands
from grabnet.evaluation.protocols.ground_truth import recorded_hands
from grabnet.evaluation.settings import Evaluation
from grabnet.generation.grabber import Grabber
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.io.cache import default_cache
from grabnet.io.files import sha256
from grabnet.models.trained import check_hand, find_pair
from grabnet.models.weights import load_coarsenet, load_refinenet, weights_file


class Material:
    """What is evaluated on.

    Attributes:
        hand, labels: the hand model, and what its vertices are. data: the module, not set up. store: its frames.
        part, training_part: the store with the frames of the evaluated split, and of training, only.
        files: of all objects' meshes, by name. cache: of results.
        objects: names of those that are evaluated; meshes and truth: theirs, by name.

    Raises:
        UserError: data that is missing, or objects that are not in the split.
    """

    def __init__(self, wanted: Evaluation):
        self.wanted = wanted
        self.hand: HandModel = instantiate(wanted.hand_model)
        self.labels = HandLabels.of(self.hand)
        self.data: GraspDataModule = instantiate(wanted.data, hand=self.hand)
        self.data.prepare_data()
        self.store = self.data.store
        self.part = self.data.part(wanted.split)
        self.training_part = self.data.part("train")
        self.files = object_files(self.data.objects_dir)
        self.cache = Cache(Path(wanted.cache_dir or default_cache()) / "evaluation")
        self.objects = self._objects()
        self.meshes: dict[str, Mesh] = {name: load_mesh(self.files[name]) for name in self.objects}
        self.truth: dict[str, Hands] = {
            name: recorded_hands(self.part, self.hand, name, mesh, wanted.max_ground_truth)
            for name, mesh in self.meshes.items()
        }

    def _objects(self) -> list[str]:
        objects = self.part.shown_objects
        if unknown := [name for name in self.wanted.only or [] if name not in objects]:
            raise UserError(f"only names {unknown[0]}; the {self.wanted.split} objects are {', '.join(objects)}.")
        objects = self.wanted.only or objects
        if missing := [name for name in objects if name not in self.files]:
            raise UserError(f"{self.data.objects_dir} has no mesh for {', '.join(missing)}.")
        if not objects:
            raise UserError(f"{self.data.store_dir} has no grasp of a {self.wanted.split} object.")
        return objects

    @cached_property
    def training_objects(self) -> list[str]:
        """Names of those with a mesh, without the objects that are evaluated."""
        names = self.training_part.shown_objects
        return [name for name in names if name in self.files and name not in self.objects]

    @cached_property
    def fingerprint(self) -> list[str]:
        """Of all frames, whom they show and how they are split, of the objects and the hand."""
        values = (getattr(self.store.frames, name) for name in self.store.frames.__dataclass_fields__)
        frames = [value.numpy() for value in values if value is not None]
        split = self.data.split
        names = [*self.store.objects, "|", split.by, *sorted(split.val), "|", *sorted(split.test)]
        meshes = [sha256(self.files[name]) for name in self.store.objects if name in self.files]
        hand = [self.hand.v_template.numpy(), self.hand.weights.numpy()]
        return [sha256(*frames), sha256(self.store.v_template.numpy()), sha256(*hand), *names, *meshes]

    @cached_property
    def training_keypoints(self) -> np.ndarray:
        """(M, 21, 3) of the training grasps, for `novelty`."""

        # Where the hand is does not matter, but to rounding: always the same mesh's centroid, whatever is evaluated.
        mesh = load_mesh(self.files[min(self.files)])

        def find() -> dict[str, np.ndarray]:
            part = self.training_part
            hands = [recorded_hands(part, self.hand, name, mesh) for name in part.shown_objects]
            return {"keypoints": np.concatenate([self.labels.keypoints(h) for h in hands])}

        return self.cache.get("keypoints", [*self.fingerprint, mesh.sha256], find)["keypoints"]


@dataclass(frozen=True)
class Networks:
    """The trained networks to evaluate: their files and hashes, by name."""

    files: dict[str, Path]

    @classmethod
    def of(cls, wanted: Evaluation, hand: HandModel) -> Networks:
        """Those named; where none is, nor any folder of grasps, the newest, or the shipped ones.

        Raises:
            UserError: a RefineNet without a CoarseNet to start from, none there, or trained with another hand.
        """
        if wanted.refinenet and not wanted.coarsenet:
            raise UserError("refinenet is given without coarsenet, from whose grasps it starts: name that, too.")
        if wanted.coarsenet:
            named = {"coarsenet": wanted.coarsenet, "refinenet": wanted.refinenet}
            files = {name: weights_file(path) for name, path in named.items() if path}
        elif not wanted.folders:
            files = dict(zip(("coarsenet", "refinenet"), find_pair(runs=wanted.runs), strict=True))
        else:
            files = {}
        for path in files.values():
            check_hand(path, hand)
        return cls(files)

    @cached_property
    def hashes(self) -> dict[str, str]:
        return {name: sha256(path) for name, path in self.files.items()}

    def grabber(self, hand: HandModel, refine: bool) -> Grabber:
        refinenet = load_refinenet(self.files["refinenet"], hand) if refine else None
        return Grabber(load_coarsenet(self.files["coarsenet"]), refinenet, hand)
