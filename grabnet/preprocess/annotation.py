"""Contact of whole recordings, and how far two annotations of one agree."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from grabnet.body.whole import BodyModel
from grabnet.data.sequences import ContactTrack, Sequence
from grabnet.geometry.mesh import Mesh
from grabnet.preprocess.contact import ContactAnnotator, vertex_parts

# Frames posed at once; a body has so many vertices that more would only take memory.
_BATCH = 64


@torch.no_grad()
def annotate(
    sequence: Sequence, body: BodyModel, v_template: Tensor, thing: Mesh, distance: float = 0.0045
) -> ContactTrack:
    """Contact labels of every frame, from the surfaces alone.

    Args:
        body: the whole body model. v_template: (V, 3) the subject's.
        thing: the object's contact mesh, its vertices numbered as in the file.
        distance: ε of `ContactAnnotator`, metres.
    """
    annotator = ContactAnnotator(
        thing, v_template.numpy(), body.faces.numpy(), vertex_parts(body.weights.numpy()), distance
    )
    found = []
    for start in range(0, len(sequence), _BATCH):
        frames = slice(start, start + _BATCH)
        rest = body.shaped(expression=torch.as_tensor(sequence.body.expression[frames]), v_template=v_template)
        vertices = body(sequence.body.parameters(frames), rest).vertices
        found += [annotator(frame) for frame in sequence.object.to_local(vertices, frames).numpy()]
    return ContactTrack(np.stack([f.object for f in found]), np.stack([f.body for f in found]))


def agreement(one: np.ndarray, other: np.ndarray) -> dict[int, float]:
    """Intersection over union of two annotations (T, V), for each part that either of them has."""
    parts = np.union1d(one, other)
    return {
        int(part): float(((one == part) & (other == part)).sum() / ((one == part) | (other == part)).sum())
        for part in parts[parts > 0]
    }
