"""Data sets that can be analysed: recordings in GRAB's layout, and generated grasps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree

from grabnet.analysis.frames import SURFACES, Frames, Group, Posed, Solid
from grabnet.analysis.markers import read_markers
from grabnet.body.hand import HandModel
from grabnet.body.skeleton import RIGHT_HAND_JOINTS
from grabnet.body.whole import BodyModel
from grabnet.cli.checks import Name
from grabnet.contact.annotator import vertex_parts
from grabnet.contact.sequences import posed
from grabnet.data.intents import intent_of
from grabnet.data.names import is_plain
from grabnet.data.sequences import Sequence, load_below
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.io.files import sha256
from grabnet.preprocess.grasp_track import GraspTrack, mirrored
from grabnet.preprocess.recordings import GrabRecordings


class Surface(NamedTuple):
    """The body that contact is shown on.

    vertices: (V, 3) metres, at rest. faces: (F, 3). parts: (V,) uint8, the part of each vertex (ref. 1).
    right_hand: (778,) the body's vertices that are those of the right hand model.
    """

    vertices: np.ndarray
    faces: np.ndarray
    parts: np.ndarray
    right_hand: np.ndarray


class DataSet(ABC):
    """What can be analysed. It is sent to workers, so it must pickle.

    Attributes:
        label: names it in the report.
        is_synthetic: whether nobody was recorded.
    """

    label: str
    is_synthetic: bool

    @property
    @abstractmethod
    def folder(self) -> Path:
        """That the files lie below."""

    @abstractmethod
    def names(self) -> list[str]:
        """Names of all sequences; a `UserError` where there are none."""

    @abstractmethod
    def recipe(self) -> dict[str, Any]:
        """All that decides what `frames` gives besides the files, JSON-able."""

    @abstractmethod
    def frames(self, name: str) -> tuple[Frames, dict[str, str]]:
        """One sequence, and the SHA-256 of the files it was read from, by their path below `folder`."""

    @abstractmethod
    def objects(self) -> Mapping[str, Path]:
        """Mesh file of each object."""

    @property
    @abstractmethod
    def surface(self) -> Surface:
        """The body; its vertices are numbered as in `Frames.body`."""

    @abstractmethod
    def hand(self) -> HandModel:
        """The right hand's model."""

    def object_markers(self, field: str) -> Mapping[str, np.ndarray]:
        """(M, 3) metres in the object's frame, of each object whose markers are known.

        Args:
            field: of the config, that names them, for errors.
        """
        return {}

    def object_mesh(self, name: str) -> Mesh:
        """The mesh of an object, its vertices numbered as in `Frames.object`."""
        return load_mesh(self.objects()[name], weld=False)


@dataclass(frozen=True)
class Recordings(GrabRecordings, DataSet):
    """Recordings in GRAB's layout.

    Args:
        label: names the data set in the report.
        is_synthetic: whether nobody was recorded.
        markers: where markers were on the objects, as `grabnet.analysis.markers` reads it; None: unknown.
    """

    label: Name = "recordings"
    is_synthetic: bool = False
    markers: Name | None = None

    def __post_init__(self):
        super().__post_init__()
        check_label(self.label)

    def recipe(self) -> dict[str, Any]:
        """As of labels that are found: depths come from the bodies, wherever the labels are from."""
        recipe = super().recipe()
        bodies = {self.body_file(gender) for gender in ("female", "male")}
        return recipe | {"models": recipe["models"] | {path.name: sha256(path) for path in sorted(bodies)}}

    def frames(self, name: str) -> tuple[Frames, dict[str, str]]:
        recording = self.read(name)
        sequence = recording.sequence
        height, n = sequence.object.transl[:, 2], sequence.contact.body.shape[1]
        if n != len(self.surface.parts):
            raise UserError(
                f"grab/{name}.npz labels {n} vertices of a body, the subjects' meshes have {len(self.surface.parts)}: "
                "recordings of one data set must be of one kind of body."
            )
        template = load_below(self.folder, sequence.body.vtemp, mend=False).vertices
        if len(template) != n:
            raise UserError(f"{sequence.body.vtemp} has {len(template)} vertices, the body {n}.")
        frames = Frames(
            name=name,
            group=Group(intent_of(sequence.motion_intent), sequence.sbj_id, sequence.obj_name),
            object=sequence.contact.object,
            body=sequence.contact.body,
            lift=height - height[0],
            surfaces={
                "hands": [self._posed_hand(recording.right), self._posed_hand(recording.left_mirrored())],
                "head": [self._posed_body(sequence, template, SURFACES["head"])],
                "body": [self._posed_body(sequence, template, SURFACES["body"])],
            },
            solid=lambda: _solid(self.objects()[sequence.obj_name]),
            hand_length=float(np.ptp(self.rest(sequence.rhand.vtemp).numpy(), 0).max()),
        )
        return frames, recording.inputs | {sequence.body.vtemp: sha256(self.folder / sequence.body.vtemp)}

    @cached_property
    def surface(self) -> Surface:
        template = next(iter(sorted((self.folder / "tools/subject_meshes").glob("*/s*[0-9].ply"))), None)
        if template is None:
            raise UserError(f"{self.folder}/tools/subject_meshes holds no subject: unpack the data set's tools, too.")
        mesh = load_below(self.folder, str(template.relative_to(self.folder)))
        model = BodyModel(self.body_file(template.parent.name))
        if len(mesh.vertices) != len(model.v_template):
            raise UserError(f"{template} has {len(mesh.vertices)} vertices, the body {len(model.v_template)}.")
        vertices = torch.tensor(mesh.vertices)
        hand = self.hand()
        # Both are modelled in one orientation: where the wrists meet, vertices do.
        shift = model.rest_joints(model.v_template)[RIGHT_HAND_JOINTS[0]] - hand.rest_joints(hand.v_template)[0]
        right = cKDTree(model.v_template.numpy()).query((hand.v_template + shift).numpy())[1]
        return Surface(vertices.numpy(), model.faces.numpy(), vertex_parts(model.weights.numpy()), right)

    def object_markers(self, field: str) -> Mapping[str, np.ndarray]:
        return {} if self.markers is None else read_markers(self.markers, self.objects(), field)

    def _posed_body(self, sequence: Sequence, template: np.ndarray, parts: Collection[int]) -> Posed:
        """Those vertices of the whole body, of a subject's template (V, 3), that belong to some parts."""
        own = torch.tensor(np.isin(self.surface.parts, list(parts)))

        @torch.no_grad()
        def pose(frames: np.ndarray) -> torch.Tensor:
            body = _body(self.body_file(sequence.gender))
            vertices = posed(sequence, body, torch.tensor(template), frames)[:, own]
            return sequence.object.to_local(vertices, frames)

        return pose

    def _posed_hand(self, track: GraspTrack) -> Posed:
        template = track.hand.vtemp

        @torch.no_grad()
        def pose(frames: np.ndarray) -> torch.Tensor:
            rest = self.rest(template)
            rest = mirrored(rest) if track.is_mirrored else rest
            vertices = _hand(self._hand_file)(track.hand.parameters(frames), rest).vertices
            here = track.object.to_local(vertices, frames)
            return mirrored(here) if track.is_mirrored else here

        return pose


def check_label(label: str) -> None:
    """Refuse a label that is no name of a folder, or that stands for something else."""
    if not is_plain(label) or label in ("all", "difference"):
        raise UserError(
            f"The label {label!r} cannot name a data set: "
            "give a name without / \\ : and a leading dot, that is neither 'all' nor 'difference'."
        )


@cache
def _hand(path: Path) -> HandModel:
    return HandModel(path)


@lru_cache(maxsize=2)
def _body(path: Path) -> BodyModel:
    return BodyModel(path)


@lru_cache(maxsize=8)
def _solid(path: Path) -> Solid:
    return Solid(load_mesh(path, weld=False))
