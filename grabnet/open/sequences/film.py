"""Sequences to look at: an animation of some of them, or a strip of frames each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from grabnet.body.whole import BodyModel
from grabnet.cli.progress import track
from grabnet.data.sequences import load_below, read_sequence
from grabnet.io.files import replacing
from grabnet.visual.pictures import OBJECT, SKIN, Shape, contact_sheet, render

_TABLE = (0.78, 0.74, 0.66)
_VIEW = (-0.75, -1.0, 0.5)  # in the table's frame: from ahead of the person, to their right
_FRAMES_PER_SECOND = 15


def save_film(path: Path, files: Sequence[Path], root: Path, size: tuple[int, int] = (300, 330)) -> None:
    """Write an animated .webp or .gif of the sequences, one after the other."""
    body, pictures = BodyModel.open(), []
    for file in files:
        sequence = read_sequence(file)
        every = round(sequence.framerate / _FRAMES_PER_SECOND)
        pictures += [Image.fromarray(p) for p in draw(file, root, body, np.arange(0, len(sequence), every), size)]
    with replacing(path) as temporary:
        first, *others = pictures
        first.save(temporary, save_all=True, append_images=others, duration=1000 // _FRAMES_PER_SECOND, loop=0)


def save_strip(path: Path, files: Sequence[Path], root: Path, n: int = 8, size: tuple[int, int] = (150, 165)) -> None:
    """Write a picture with a row of `n` frames of each sequence."""
    body, tiles, captions = BodyModel.open(), [], []
    for file in files:
        sequence = read_sequence(file)
        frames = np.linspace(0.08 * len(sequence), 0.92 * len(sequence), n).astype(int)
        tiles += draw(file, root, body, frames, size)
        captions += [f"{file.stem}, {frame / sequence.framerate:.1f} s" for frame in frames]
    sheet = Image.fromarray(contact_sheet(tiles, captions, columns=n))
    with replacing(path) as temporary:
        sheet.quantize(128).save(temporary, optimize=True)


def draw(file: Path, root: Path, body: BodyModel, frames: np.ndarray, size: tuple[int, int]) -> list[np.ndarray]:
    """uint8 pictures of chosen frames, from one side for all of them."""
    sequence = read_sequence(file)
    v_template = torch.tensor(load_below(root, sequence.body.vtemp, mend=False).vertices)
    people = body(sequence.body.parameters(frames), v_template).vertices
    room = sequence.table.rotations(slice(0, 1))[0].numpy()
    moved = []
    for moving, color in ((sequence.object, OBJECT), (sequence.table, _TABLE)):
        mesh = load_below(root, moving.mesh)
        moved.append((moving.to_world(torch.tensor(mesh.vertices), frames), mesh.faces, color))
    return [
        render(
            [Shape(people[k], body.faces, SKIN), *(Shape(v[k], faces, color) for v, faces, color in moved)],
            room @ _VIEW,
            size=size,
        )
        for k in track(range(len(frames)), f"Drawing {file.stem}")
    ]
