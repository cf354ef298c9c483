"""A contact sheet of shipped grasps: random ones of every object."""

from __future__ import annotations

from pathlib import Path

import torch
from PIL import Image

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.io.files import replacing
from grabnet.open.grasps.store import OpenGrasps
from grabnet.open.objects import build_object
from grabnet.visual.pictures import OBJECT, SKIN, Shape, contact_sheet, render

VIEWS = ((-0.45, -1.0, 0.45), (0.9, 0.5, 0.35))


def draw_sheet(grasps: OpenGrasps, path: Path, per_object: int = 2, size: int = 150, seed: int = 0) -> None:
    """Draw `per_object` random grasps of each object, each from another side."""
    generator = torch.Generator().manual_seed(seed)
    hand = HandModel.open()
    anatomy = Anatomy.of(hand)
    tiles, captions = [], []
    for number, name in enumerate(grasps.objects):
        mesh = build_object(name)
        rows = torch.where(grasps.object == number)[0]
        for k, row in enumerate(rows[torch.randperm(len(rows), generator=generator)[:per_object]].tolist()):
            rest = hand.shaped(grasps.betas[grasps.subject[row]])
            vertices = hand(grasps.parameters(anatomy, torch.tensor([row])), rest).vertices[0]
            shapes = [Shape(vertices, hand.faces, SKIN), Shape(mesh.vertices, mesh.faces, OBJECT)]
            tiles.append(render(shapes, direction=VIEWS[k % len(VIEWS)], size=(size, size)))
            captions.append(f"{name}: {grasps.kinds[grasps.kind[row]]}")
    sheet = Image.fromarray(contact_sheet(tiles, captions, columns=13))
    with replacing(path) as temporary:  # with a palette: half the file, no visible loss
        sheet.quantize(200, dither=Image.Dither.NONE).save(temporary, optimize=True)
