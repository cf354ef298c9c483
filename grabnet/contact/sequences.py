"""Contact of whole recordings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from grabnet.body.skeleton import N_PARTS
from grabnet.body.whole import BodyModel
from grabnet.contact.annotator import Contact, ContactAnnotator, vertex_parts
from grabnet.contact.bones import Bones
from grabnet.contact.contacts import CONTACT_DISTANCE
from grabnet.contact.rules import ContactRules
from grabnet.data.sequences import ContactTrack, Sequence
from grabnet.geometry.mesh import Mesh

# Frames posed at once; a body has so many vertices that more would only take memory.
_BATCH = 64


class TouchedFrame(NamedTuple):
    """Dense correspondence of one frame.

    vertices: (N,) int32, which vertices of the object are touched.
    face: (N,) int32, the face of the body nearest to each.
    barycentric: (N, 3) float32, weights of that face's corners that make up the nearest point.
    """

    vertices: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray

    @classmethod
    def of(cls, contact: Contact) -> TouchedFrame:
        touched = (contact.face >= 0).nonzero()[0]
        return cls(touched.astype(np.int32), contact.face[touched], contact.barycentric[touched])


@dataclass(frozen=True)
class Annotation:
    """Contact of a recording of T frames.

    labels: parts that touch, as GRAB has them.
    correspondence: of each frame.
    """

    labels: ContactTrack
    correspondence: list[TouchedFrame]


@torch.no_grad()
def annotate(
    sequence: Sequence,
    body: BodyModel,
    v_template: Tensor,
    object_mesh: Mesh,
    distance: float = CONTACT_DISTANCE,
    every: int = 1,
    rules: ContactRules = ContactRules(),  # noqa: B008, frozen
) -> Annotation:
    """Find contact from the surfaces alone.

    Args:
        sequence: the recording; its labels are not read.
        body: the whole body model.
        v_template: (V, 3) the subject's.
        object_mesh: the object's contact mesh, its vertices numbered as in the file.
        distance: ε of `ContactAnnotator`, metres.
        every: n, to label only every n-th frame; nothing touches in the others.
        rules: what ε is measured to, and whose part it is.
    """
    annotator = body_annotator(body, v_template.numpy(), object_mesh, distance, rules)
    labels = ContactTrack(
        np.zeros((len(sequence), len(object_mesh.vertices)), np.uint8),
        np.zeros((len(sequence), len(v_template)), np.uint8),
    )
    nothing = TouchedFrame(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros((0, 3), np.float32))
    correspondence = [nothing] * len(sequence)
    numbers = np.arange(0, len(sequence), every)
    for start in range(0, len(numbers), _BATCH):
        frames = numbers[start : start + _BATCH]
        vertices = posed(sequence, body, v_template, frames)
        for number, here in zip(frames, sequence.object.to_local(vertices, frames).numpy(), strict=True):
            found = annotator(here)
            labels.object[number], labels.body[number] = found.object, found.body
            correspondence[number] = TouchedFrame.of(found)
    return Annotation(labels, correspondence)


def body_annotator(
    body: BodyModel, v_template: np.ndarray, object_mesh: Mesh, distance: float, rules: ContactRules
) -> ContactAnnotator:
    """Return the annotator of a subject, whose parts are numbered as in GRAB (ref. 1)."""
    return ContactAnnotator(
        object_mesh,
        v_template,
        body.faces.numpy(),
        vertex_parts(body.weights.numpy()),
        distance,
        rules.measured_to,
        Bones.of(body, v_template, range(1, N_PARTS + 1)) if rules.part_by == "bone" else None,
    )


def posed(sequence: Sequence, body: BodyModel, v_template: Tensor, frames: np.ndarray) -> Tensor:
    """(N, V, 3) metres, in the world: the body in chosen frames (N,)."""
    rest = body.shaped(expression=torch.as_tensor(sequence.body.expression[frames]), v_template=v_template)
    return body(sequence.body.parameters(frames), rest).vertices
