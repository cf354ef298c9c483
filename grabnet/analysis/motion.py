"""Meshes of a recording over time (paper S.2): what `grabnet meshes` does.

The folder gets, of the formats asked for,
    film.webp                                  the whole body from one side; beside it the object from nearby
    motion.glb                                 an animation of body and object
    frames/<number>_body.ply, …_object.ply     one frame in the world, metres, with the property `contact`
    frames/<number>.npz                        the same: body, object (V, 3); contact_body, contact_object (V,) uint8
    faces.npz                                  with npz: body, object (F, 3), which all frames share
    meshes.json                                what they were made of
All are coloured by the part that touches (ref. 1), where one does.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
import torch
from PIL import Image

from grabnet.analysis.data_set import Recordings
from grabnet.body.whole import BodyModel
from grabnet.cli.checks import Count, Distance, Filled, Name, in_range
from grabnet.cli.progress import track
from grabnet.contact.coloured import PART_COLOURS, write_labelled
from grabnet.contact.rules import ContactRules
from grabnet.contact.sequences import posed
from grabnet.data.sequences import load_below
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import filling, write_bytes, write_json
from grabnet.io.provenance import provenance
from grabnet.visual.animated import Moving, animated_glb
from grabnet.visual.pictures import OBJECT, SKIN, Shape, can_render, render

FORMATS = ("film", "glb", "ply", "npz")
RESULTS = ("frames/*.ply", "frames/*.npz", "faces.npz", "film.webp", "motion.glb", "meshes.json")
_BATCH = 64
_THIN = 7  # every so many vertices say where body and object are
_SIZE, _VIEW = (460, 520), (-0.75, -1.0, 0.5)  # pixels; from ahead of the person at the table, to their right
_ABOUT = 0.05  # metres around an object that are seen with it


@dataclass(frozen=True)
class MeshesConfig:
    """The values of `configs/analyze/meshes.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    data: Recordings
    sequence: Name
    every: Count
    formats: Annotated[Sequence[Name], Filled()]
    output: Name
    contact_distance: Distance
    contact: ContactRules = field(default_factory=ContactRules)  # for `data`, whose config refers to it
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        if unknown := sorted(set(self.formats) - set(FORMATS)):
            raise UserError(f"There is no format {', '.join(unknown)}; choose from {', '.join(FORMATS)}.")


class Frame(NamedTuple):
    """One frame in the world: number, meshes in metres, and the part that touches each vertex (V,) uint8."""

    number: int
    body: Mesh
    object: Mesh
    body_labels: np.ndarray
    object_labels: np.ndarray


@dataclass(frozen=True)
class Motion:
    """Frames of a recording, posed as they are read.

    Attributes:
        rate: frames per second.
        view: (3,) direction from which to look.
        room: (P, 3) metres, where body and object are over the whole recording.
        reach: metres, half of what a close view of the object shows.
        frames: the frames; a generator, to be read once.
        count: how many.
    """

    rate: float
    view: np.ndarray
    room: np.ndarray
    reach: float
    frames: Iterator[Frame]
    count: int


def run(config: MeshesConfig) -> int:
    """Write what was asked for; the exit code."""
    if "film" in config.formats and (reason := can_render()):
        raise UserError(f"{reason} Leave film out of formats.")
    motion = motion_of(config.data, config.sequence, config.every)
    folder = Path(config.output)
    with filling(folder, RESULTS, lambda place: (place / "meshes.json").exists()) as temporary:
        pictures, kept = [], []
        for frame in track(motion.frames, f"Posing {config.sequence}", motion.count):
            _write_frame(temporary / "frames", frame, config.formats)
            if "film" in config.formats:
                pictures.append(Image.fromarray(_picture(frame, motion.view, motion.room, motion.reach)))
            if "glb" in config.formats:
                kept.append(frame)
            last = frame
        if pictures:
            first, *others = pictures
            first.save(
                temporary / "film.webp", save_all=True, append_images=others, duration=round(1000 / motion.rate), loop=0
            )
        if kept:
            write_bytes(temporary / "motion.glb", animated_glb(_moving(kept), motion.rate))
        if "npz" in config.formats:
            _write_npz(temporary / "faces.npz", body=last.body.faces, object=last.object.faces)
        facts = {"sequence": config.sequence, "every": config.every, "frames": motion.count, "rate": motion.rate}
        write_json(temporary / "meshes.json", provenance(**facts, data=config.data.recipe()))
    print(f"Wrote {motion.count} frames of {config.sequence} to {folder}.")
    return 0


def motion_of(data: Recordings, name: str, every: int) -> Motion:
    """Every n-th frame of a recording: the subject's template with expression and exact hands, the object, contact.

    Raises:
        UserError: there is no such recording, or it does not fit the body model.
    """
    if name not in (names := data.names()):
        raise UserError(f"{data.folder} holds no recording {name}; the first of {len(names)} is {names[0]}.")
    recording = data.read(name)
    sequence, solid = recording.sequence, recording.mesh
    body = BodyModel(data.body_file(sequence.gender))
    template = torch.tensor(load_below(data.folder, sequence.body.vtemp).vertices)
    if not len(template) == len(body.v_template) == sequence.contact.body.shape[1]:
        raise UserError(f"{name} is of a body of {len(template)} vertices, the model has {len(body.v_template)}.")
    numbers = np.arange(0, len(sequence), every)

    @torch.no_grad()
    def pose(chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        people = posed(sequence, body, template, chosen)
        return people.numpy(), sequence.object.to_world(torch.tensor(solid.vertices), chosen).numpy()

    def frames() -> Iterator[Frame]:
        faces = body.faces.numpy()
        for start in range(0, len(numbers), _BATCH):
            chosen = numbers[start : start + _BATCH]
            people, moved = pose(chosen)
            for k, number in enumerate(chosen):
                labels = sequence.contact.body[number], sequence.contact.object[number]
                yield Frame(int(number), Mesh(people[k], faces), Mesh(moved[k], solid.faces), *labels)

    table = sequence.table.rotations(slice(0, 1))[0].numpy()
    reach = float(np.linalg.norm(np.ptp(solid.vertices, 0))) / 2 + _ABOUT
    room = _room(pose, numbers)
    return Motion(sequence.framerate / every, table @ np.array(_VIEW), room, reach, frames(), len(numbers))


def _room(pose: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]], numbers: np.ndarray) -> np.ndarray:
    """(P, 3) points of body and object in frames evenly spread, between which they cannot move far."""
    chosen = numbers[np.linspace(0, len(numbers) - 1, min(len(numbers), _BATCH)).astype(int)]
    return np.concatenate([vertices[:, ::_THIN].reshape(-1, 3) for vertices in pose(chosen)])


def _write_frame(folder: Path, frame: Frame, formats: Sequence[str]) -> None:
    if "ply" in formats:
        write_labelled(folder / f"{frame.number:05d}_body.ply", frame.body, frame.body_labels)
        write_labelled(folder / f"{frame.number:05d}_object.ply", frame.object, frame.object_labels)
    if "npz" in formats:
        _write_npz(
            folder / f"{frame.number:05d}.npz",
            body=frame.body.vertices,
            object=frame.object.vertices,
            contact_body=frame.body_labels,
            contact_object=frame.object_labels,
        )


def _write_npz(path: Path, **arrays: np.ndarray) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_bytes(path, buffer.getvalue())


def _picture(frame: Frame, view: np.ndarray, room: np.ndarray, reach: float) -> np.ndarray:
    shapes = [
        Shape(mesh.vertices, mesh.faces, np.where(labels[:, None] > 0, PART_COLOURS[labels] / 255, plain))
        for mesh, labels, plain in (
            (frame.body, frame.body_labels, SKIN), (frame.object, frame.object_labels, OBJECT),
        )
    ]  # fmt: skip
    # The second camera moves with the object, and stays as far from it however it is turned.
    low, high = frame.object.vertices.min(0), frame.object.vertices.max(0)
    near = (low + high) / 2 + reach * np.concatenate([np.eye(3), -np.eye(3)])
    return np.concatenate([render(shapes, view, size=_SIZE, around=points) for points in (room, near)], 1)


def _moving(frames: Sequence[Frame]) -> dict[str, Moving]:
    parts = {}
    for name in ("body", "object"):
        meshes = [getattr(frame, name) for frame in frames]
        labels = np.stack([getattr(frame, f"{name}_labels") for frame in frames])
        parts[name] = Moving(np.stack([mesh.vertices for mesh in meshes]), meshes[0].faces, PART_COLOURS[labels])
    return parts
