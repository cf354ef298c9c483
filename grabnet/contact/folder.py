"""Recomputed contact of recordings on disk.

    <root>/recipe.json                              how it was found
    <root>/grab/<subject>/<sequence>.npz            the recording with these labels, in GRAB's layout (ref. 1)
    <root>/correspondence/<subject>/<sequence>.npz  which point of the body each touched vertex of the object meets:
        face         (T, V of the object) int32, the body's face nearest to the vertex; -1 where nothing touches
        barycentric  (T, V of the object, 3) float32, weights of that face's corners; NaN where nothing touches
    <root>/frames/<subject>/<sequence>_<frame>_object.ply, …_body.ply   one frame in the world, coloured by part

Faces are numbered as in the body model's file, vertices as in the object's. A recording's file below `grab` is written
last: where it lies, the others are complete.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grabnet.contact.coloured import write_labelled
from grabnet.contact.sequences import Annotation, TouchedFrame
from grabnet.data.sequences import Sequence, write_sequence
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import replacing
from grabnet.io.litter import clear_litter
from grabnet.io.recipes import claim

# Raise it when the files must be read otherwise.
FORMAT = 1


class ContactFolder:
    """A folder of recomputed contact.

    Args:
        root: the folder.
    """

    def __init__(self, root: Path):
        self.root = root

    def start(self, recipe: Mapping[str, Any]) -> None:
        """Make the folder ready for contact found by a recipe; remove what a killed process left half-written.

        Raises:
            UserError: the folder holds contact found by another recipe.
        """
        claim(self.root / "recipe.json", {"format": FORMAT, **recipe}, f"delete {self.root}, or choose another folder")
        clear_litter(self.root, "*/*/*.*")

    def holds(self, name: str) -> bool:
        """Whether the contact of a recording is there."""
        return self._file("grab", name).exists()

    def write(self, sequence: Sequence, annotation: Annotation) -> None:
        """Write a recording, which has the annotation's labels, and its dense correspondence."""
        write_correspondence(
            self._file("correspondence", sequence.name), annotation.correspondence, sequence.contact.object.shape[1]
        )
        write_sequence(self._file("grab", sequence.name), sequence)

    def write_frame(
        self, sequence: Sequence, number: int, object_mesh: Mesh, vertices: Tensor, faces: np.ndarray
    ) -> None:
        """Write the object and the body of one frame, coloured by part.

        Args:
            sequence: the recording.
            number: of the frame.
            object_mesh: the object's mesh, in its own frame.
            vertices: (V, 3) metres, the body in the world.
            faces: (F, 3) of the body.
        """
        frame = slice(number, number + 1)
        place = self.root / "frames" / f"{sequence.name}_{number}"
        in_world = sequence.object.to_world(torch.tensor(object_mesh.vertices), frame)[0].numpy()
        for what, mesh, labels in (
            ("object", Mesh(in_world, object_mesh.faces), sequence.contact.object[number]),
            ("body", Mesh(vertices.numpy(), faces), sequence.contact.body[number]),
        ):
            write_labelled(place.with_name(f"{place.name}_{what}.ply"), mesh, labels)

    def _file(self, kind: str, name: str) -> Path:
        return self.root / kind / f"{name}.npz"


def write_correspondence(path: Path, frames: list[TouchedFrame], n_vertices: int) -> None:
    """Write `face` and `barycentric` of T frames as a compressed `.npz`, atomically, a frame in memory at a time."""

    def faces(frame: TouchedFrame) -> np.ndarray:
        dense = np.full(n_vertices, -1, np.int32)
        dense[frame.vertices] = frame.face
        return dense

    def weights(frame: TouchedFrame) -> np.ndarray:
        dense = np.full((n_vertices, 3), np.nan, np.float32)
        dense[frame.vertices] = frame.barycentric
        return dense

    shape = len(frames), n_vertices
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        _write_array(archive, "face", np.dtype(np.int32), shape, map(faces, frames))
        _write_array(archive, "barycentric", np.dtype(np.float32), (*shape, 3), map(weights, frames))


def _write_array(
    archive: zipfile.ZipFile, name: str, dtype: np.dtype, shape: tuple[int, ...], rows: Iterable[np.ndarray]
) -> None:
    with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
        header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        for row in rows:
            file.write(row.tobytes())
