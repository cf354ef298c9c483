"""Contact of whole recordings."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from grabnet.body.whole import BodyModel
from grabnet.contact.annotator import ContactAnnotator, vertex_parts
from grabnet.data.sequences import ContactTrack, Sequence
from grabnet.geometry.mesh import Mesh

# Frames posed at once; a body has so many vertices that more would only take memory.
_BATCH = 64


@torch.no_grad()
def annotate(
    sequence: Sequence,
    body: BodyModel,
    v_template: Tensor,
    thing: Mesh,
    distance: float = 0.0045,
    every: int = 1,
) -> ContactTrack:
    """Contact labels from the surfaces alone.

    Args:
        body: the whole body model. v_template: (V, 3) the subject's.
        thing: the object's contact mesh, its vertices numbered as in the file.
        distance: ε of `ContactAnnotator`, metres.
        every: n, to label only every n-th frame; the others' labels are 0.
    """
    annotator = ContactAnnotator(
        thing, v_template.numpy(), body.faces.numpy(), vertex_parts(body.weights.numpy()), distance
    )
    labels = ContactTrack(
        np.zeros((len(sequence), len(thing.vertices)), np.uint8), np.zeros((len(sequence), len(v_template)), np.uint8)
    )
    numbers = np.arange(0, len(sequence), every)
    for start in range(0, len(numbers), _BATCH):
        frames = numbers[start : start + _BATCH]
        rest = body.shaped(expression=torch.as_tensor(sequence.body.expression[frames]), v_template=v_template)
        vertices = body(sequence.body.parameters(frames), rest).vertices
        for number, posed in zip(frames, sequence.object.to_local(vertices, frames).numpy(), strict=True):
            found = annotator(posed)
            labels.object[number], labels.body[number] = found.object, found.body
    return labels
