"""Contact labels of a recording, from its surfaces, once for as long as hand and object keep their places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from grabnet.contact.contacts import CONTACT_DISTANCE
from grabnet.contact.rules import ContactRules
from grabnet.contact.sequences import body_annotator
from grabnet.data.sequences import ContactTrack, Sequence
from grabnet.open.sequences.actor import Actor
from grabnet.open.sequences.props import StageProp

_BATCH = 64
_NEAR = 0.008  # metres from the object: what is farther can't be labelled, nor change a label
_MOVED = 0.00005  # metres: a frame in which nothing near the object has moved by more has the labels of the one before


@torch.no_grad()
def with_contact(sequence: Sequence, actor: Actor, prop: StageProp) -> Sequence:
    """The sequence with labels as `grabnet.contact.sequences.annotate` finds them.

    A hand that holds an object keeps its place on it; labels are sought again when anything near the object moves.
    """
    annotator = body_annotator(actor.body, actor.subject.v_template, prop.mesh, CONTACT_DISTANCE, ContactRules())
    low, high = prop.mesh.bounds[0] - _NEAR, prop.mesh.bounds[1] + _NEAR
    n = len(sequence)
    found = ContactTrack(
        np.zeros((n, len(prop.vertices)), np.uint8), np.zeros((n, len(actor.subject.v_template)), np.uint8)
    )
    before, near_before = None, np.zeros(len(actor.subject.v_template), bool)
    for start in range(0, n, _BATCH):
        frames = slice(start, start + _BATCH)
        vertices = actor.body(sequence.body.parameters(frames), actor.v_template).vertices
        local = sequence.object.to_local(vertices, frames).numpy()
        for k, here in enumerate(local, start):
            near = ((here > low) & (here < high)).all(1)
            if near.any():
                near[near] = prop.distance(here[near]) < _NEAR
            if not near.any():
                before = None
                continue
            either = near | near_before
            if before is None or np.abs(here[either] - before[either]).max() > _MOVED:
                labels = annotator(here)
                before, near_before = here, near
            found.object[k], found.body[k] = labels.object, labels.body
    return replace(sequence, contact=found)
