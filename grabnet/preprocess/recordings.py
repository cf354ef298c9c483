"""Recordings of hands and objects, which frames are filtered from: what they must tell, and GRAB's own."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.body.whole import OPEN_BODY, BodyModel
from grabnet.cli.checks import Amount, Count, Distance, Name, in_range, one_of
from grabnet.contact.folder import ContactFolder
from grabnet.contact.rules import ContactRules
from grabnet.contact.sequences import annotate, posed
from grabnet.data.objects import OBJECT_MESHES, object_files
from grabnet.data.sequences import Sequence, load_below, read_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, read_mesh
from grabnet.io.files import existing, sha256
from grabnet.io.names import originals
from grabnet.preprocess.grasp_track import GraspTrack
from grabnet.preprocess.heights import gap_to_table
from grabnet.preprocess.statistics import contact_counts, overlap

LABELS = ("stored", "recompute")


class Recording(ABC):
    """One recording, read.

    Attributes:
        right: what the right hand does.
        centroid: (3,) metres, mean vertex of the object's mesh, in the object's frame.
        inputs: SHA-256 of every file that the frames follow from, by its path below `RecordingSource.folder`.
    """

    right: GraspTrack
    centroid: np.ndarray
    inputs: dict[str, str]

    def left_mirrored(self) -> GraspTrack:
        """What the left hand does, as a mirror shows it; see `GraspTrack.left_mirrored`."""
        raise UserError(f"{self.right.name} has no left hand: set filter.mirror_left=false.")

    def gap_to_table(self) -> np.ndarray:
        """(T,) metres between the object and the table below it."""
        raise UserError(f"{self.right.name} has no table: set filter.height=frame0.")

    def counts(self) -> dict[str, Any]:
        """Further counts for the card, JSON-able: "contact" as of `contact_counts`, "overlap" of two annotations."""
        return {}


class RecordingSource(ABC):
    """A data set as recordings with contact labels. It is sent to workers, so it must pickle."""

    @property
    @abstractmethod
    def folder(self) -> Path:
        """Absolute path that the recordings' files lie below."""

    @abstractmethod
    def names(self) -> list[str]:
        """Names of all recordings, `<subject>/<object>_<action>_<k>`; a `UserError` where there are none."""

    @abstractmethod
    def objects(self) -> Mapping[str, Path]:
        """Mesh file of each object, by name; metres."""

    @abstractmethod
    def hand(self) -> HandModel:
        """The right hand that the poses are for."""

    @abstractmethod
    def recipe(self) -> dict[str, Any]:
        """All that decides what `read` gives besides the recordings' files, JSON-able; the models' hashes among it."""

    @abstractmethod
    def read(self, name: str) -> Recording:
        """One recording; a `UserError` where it cannot be used."""

    def start(self) -> None:  # noqa: B027, optional
        """Make ready for `read` to write files of its own, before any worker starts."""

    def is_complete(self, name: str) -> bool:
        """Whether all files of its own that `read` writes of a recording are there."""
        return True

    @abstractmethod
    def rest(self, template: str) -> Tensor:
        """(V, 3) rest vertices, metres, of a subject's hand that a `GraspTrack` names as its template."""


@dataclass(frozen=True)
class GrabRecordings(RecordingSource):
    """A folder of recordings in GRAB's layout, and the hand and body models that their poses are for.

    Args:
        root: folder with `grab/<subject>/*.npz` and `tools/`.
        models: folder with MANO's and SMPL-X's files, in it or in its `mano` and `smplx`; the open hand and body when
            omitted.
        contact: "stored", the labels in the files; or "recompute", labels found from the surfaces.
        contact_distance: ε of `ContactAnnotator`, metres.
        every: n, to find the labels of every n-th frame only.
        rules: what ε is measured to, and whose part it is, in labels that are found.
        contact_output: folder that labels found are written to, as a `ContactFolder`; None to write none.
        contact_frame: number of a frame of each recording that is written there as coloured meshes; None for none.

    Raises:
        UserError: another `contact`, or values of what is written that do not go together.
    """

    root: Name
    models: Name | None
    contact: str
    contact_distance: Distance
    every: Count
    rules: ContactRules
    contact_output: Name | None = None
    contact_frame: Amount | None = None

    def __post_init__(self):
        one_of(self, "data.", contact=LABELS)
        in_range(self, "data.")
        if self.contact_output is not None:
            if self.contact != "recompute":
                raise UserError("data.contact_output takes labels found here: give data.contact=recompute, too.")
            if self._contact_folder.root == self.folder:
                raise UserError(f"data.contact_output is data.root, {self.folder}, whose recordings would be replaced.")
        if self.contact_frame is not None:
            if self.contact_output is None:
                raise UserError("data.contact_frame says what is written to a folder: give data.contact_output, too.")
            if self.contact_frame % self.every:
                raise UserError(
                    f"data.contact_frame is {self.contact_frame}, which has no labels: give a multiple of {self.every}."
                )

    @cached_property
    def folder(self) -> Path:
        return Path(self.root).resolve()

    def names(self) -> list[str]:
        files = originals(self.folder.glob("grab/*/*.npz"), self.folder)
        names = [f"{file.parent.name}/{file.stem}" for file in files]
        if not names:
            remedy = "make them with python scripts/build_open.py sequences"
            if self.models is not None:
                remedy = "unpack GRAB with python scripts/unpack_grab.py and name its folder with data.root="
            raise UserError(f"{self.folder} holds no recordings grab/<subject>/<sequence>.npz: {remedy}.")
        return names

    def objects(self) -> Mapping[str, Path]:
        return self._objects

    def hand(self) -> HandModel:
        return HandModel(self._hand_file)

    def recipe(self) -> dict[str, Any]:
        genders = ("female", "male") if self.contact == "recompute" else ()
        bodies = sorted({self.body_file(gender) for gender in genders})
        rules = {"contact_rules": asdict(self.rules)} if self.contact == "recompute" else {}
        return {
            "contact": self.contact,
            "contact_distance": self.contact_distance,
            **rules,
            "models": {path.name: sha256(path) for path in (self._hand_file, *bodies)},
        }

    def start(self) -> None:
        if self.contact_output is not None:
            self._contact_folder.start(self.recipe() | {"every": self.every, "frame": self.contact_frame})

    def is_complete(self, name: str) -> bool:
        return self.contact_output is None or self._contact_folder.holds(name)

    def read(self, name: str) -> GrabRecording:
        files = _Files(self.folder)
        path = files.used(f"grab/{name}.npz")
        sequence = read_sequence(path, self._objects)
        mesh_file = str(self._objects[sequence.obj_name].relative_to(self.folder))
        mesh = files.mesh(mesh_file)
        if (n := sequence.contact.object.shape[1]) != len(mesh.vertices):
            raise UserError(f"{path} labels {n} vertices of an object that has {len(mesh.vertices)} in {mesh_file}.")
        overlaps = None
        if self.contact == "recompute":
            sequence, overlaps = self._annotated(sequence, mesh, files.unmended(sequence.body.vtemp))
        centroid = files.centroid(mesh_file)
        return GrabRecording(sequence, mesh, centroid, self._n_vertices, files, overlaps)

    def rest(self, template: str) -> Tensor:
        return torch.tensor(load_below(self.folder, template, mend=False).vertices)

    @cached_property
    def _objects(self) -> dict[str, Path]:
        return object_files(self.folder / OBJECT_MESHES)

    @cached_property
    def _n_vertices(self) -> int:
        return len(self.hand().v_template)

    @cached_property
    def _contact_folder(self) -> ContactFolder:
        return ContactFolder(Path(self.contact_output).resolve())

    @property
    def _hand_file(self) -> Path:
        return OPEN_HANDS / "MANO_RIGHT.npz" if self.models is None else self._model("mano", "MANO_RIGHT")

    def body_file(self, gender: str) -> Path:
        """File of the whole-body model of a gender; there is but one open body."""
        if self.models is None:
            return OPEN_BODY / "SMPLX_NEUTRAL.npz"
        return self._model("smplx", f"SMPLX_{gender.upper()}")

    def _model(self, folder: str, name: str) -> Path:
        root = existing(self.models, "Folder of models (data.models)").resolve()
        for path in (root / place / f"{name}{suffix}" for place in ("", folder) for suffix in (".npz", ".pkl")):
            if path.exists():
                return path
        raise UserError(f"{root} holds neither {name} nor {folder}/{name}, as .npz or .pkl: put that model there.")

    def _annotated(self, sequence: Sequence, mesh: Mesh, template: Mesh) -> tuple[Sequence, dict[str, Any]]:
        """The recording with labels of our own, and how far they overlap with those in its file."""
        body = _body(self.body_file(sequence.gender))
        v_template, stored = torch.tensor(template.vertices), sequence.contact
        if not len(v_template) == len(body.v_template) == stored.body.shape[1]:
            raise UserError(
                f"The body has {len(body.v_template)} vertices, {sequence.body.vtemp} {len(v_template)}, "
                f"and {sequence.name} labels {stored.body.shape[1]}: they must be of one kind."
            )
        annotation = annotate(sequence, body, v_template, mesh, self.contact_distance, self.every, self.rules)
        found = annotation.labels
        annotated = replace(sequence, contact=found)
        if self.contact_output is not None:
            if (number := self.contact_frame) is not None and number < len(annotated):
                vertices = posed(annotated, body, v_template, np.array([number]))[0]
                self._contact_folder.write_frame(annotated, number, mesh, vertices, body.faces.numpy())
            self._contact_folder.write(annotated, annotation)
        sides = {"object": (found.object, stored.object), "body": (found.body, stored.body)}
        overlaps = {side: overlap(*(labels[:: self.every] for labels in both)) for side, both in sides.items()}
        return annotated, overlaps


class GrabRecording(Recording):
    """A recording of GRAB.

    Args:
        sequence: its content, with the labels to use.
        mesh: the object's, its vertices as they are labelled.
        centroid: (3,) of the welded mesh.
        n_vertices: of the hand model.
        files: that it was read from.
        overlaps: of the labels to use with those in the file, by side, where they are others.
    """

    def __init__(
        self,
        sequence: Sequence,
        mesh: Mesh,
        centroid: np.ndarray,
        n_vertices: int,
        files: _Files,
        overlaps: dict[str, Any] | None,
    ):
        self.right = GraspTrack.right(sequence)
        self.centroid = centroid
        self.sequence = sequence
        self.mesh = mesh
        self._files = files
        self._overlaps = overlaps
        # Of use at the end only, but missing it, or another hand's, is a fault of this recording.
        if (n := len(files.unmended(sequence.rhand.vtemp).vertices)) != n_vertices:
            raise UserError(f"{sequence.rhand.vtemp} has {n} vertices, the hand model {n_vertices}.")

    @property
    def inputs(self) -> dict[str, str]:
        return self._files.sha256

    def left_mirrored(self) -> GraspTrack:
        self._files.unmended(self.sequence.lhand.vtemp)  # as above
        return GraspTrack.left_mirrored(self.sequence)

    def gap_to_table(self) -> np.ndarray:
        table = self.sequence.table
        return gap_to_table(self.sequence.object, self.mesh, table, self._files.unmended(table.mesh))

    def counts(self) -> dict[str, Any]:
        contact = {"contact": contact_counts(self.sequence)}
        return contact if self._overlaps is None else contact | {"overlap": self._overlaps}


class _Files:
    """Reads files below a root, and remembers which, by hash."""

    def __init__(self, root: Path):
        self.root, self.sha256 = root, {}

    def used(self, relative: str) -> Path:
        """Its path."""
        path = existing(self.root / relative, "File")
        self.sha256[relative] = sha256(path)
        return path

    def mesh(self, relative: str) -> Mesh:
        """A mesh of known sides, its vertices as numbered; the latest are kept, as long as their files stay as is."""
        self.used(relative)
        return _mesh(self.root, relative, True, self.sha256[relative])

    def unmended(self, relative: str) -> Mesh:
        """A mesh of which only the vertices count; kept likewise."""
        self.used(relative)
        return _mesh(self.root, relative, False, self.sha256[relative])

    def centroid(self, relative: str) -> np.ndarray:
        """(3,) of a mesh as training reads it, welded."""
        self.used(relative)
        return _centroid(self.root / relative, self.sha256[relative])


@lru_cache(maxsize=32)
def _mesh(root: Path, relative: str, mend: bool, sha256: str) -> Mesh:
    return load_below(root, relative, mend)


@lru_cache(maxsize=32)
def _centroid(path: Path, sha256: str) -> np.ndarray:
    return read_mesh(path, mend=False).centroid


@lru_cache(maxsize=4)
def _body(path: Path) -> BodyModel:
    return BodyModel(path)
