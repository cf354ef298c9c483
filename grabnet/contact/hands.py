"""Contact of hands by themselves with an object."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from grabnet.cli.progress import track
from grabnet.contact.annotator import ContactAnnotator
from grabnet.contact.bones import Bones
from grabnet.contact.rules import ContactRules
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.openings import close


class ContactMaps(NamedTuple):
    """What touches in N grasps, by parts numbered as in GRAB (ref. 1).

    object: (N, V of the object) uint8, the part of the hand that touches each vertex, 0 for none.
    hand: (N, V) uint8, each touching vertex's own part, 0 for the others.
    """

    object: np.ndarray
    hand: np.ndarray


class HandAnnotator:
    """Finds contact of hands of one topology with one object. What closes the wrist belongs to the palm.

    Args:
        object_mesh: the object, metres.
        rest: (V, 3) any of the hands, metres.
        faces: (F, 3) of the hands, facing outwards.
        parts: (V,) uint8 label of each vertex, the palm's the lowest.
        distance: ε, metres.
        rules: what ε is measured to, and whose part it is.
        bones: of the hands, for parts by bone; None where they are unknown, which leaves parts to the skin.
    """

    def __init__(
        self,
        object_mesh: Mesh,
        rest: np.ndarray,
        faces: np.ndarray,
        parts: np.ndarray,
        distance: float,
        rules: ContactRules,
        bones: Bones | None = None,
    ):
        self._faces, self._n = faces, len(parts)
        closed, closed_faces = close(rest, faces)
        closed_parts = np.append(parts, np.full(len(closed) - len(parts), parts.min(), np.uint8))
        self._annotate = ContactAnnotator(
            object_mesh,
            closed,
            closed_faces,
            closed_parts,
            distance,
            rules.measured_to,
            bones if rules.part_by == "bone" else None,
        )

    def __call__(self, hands: np.ndarray) -> ContactMaps:
        """Return the contact of hands (N, V, 3), metres, in the object's frame."""
        closed = close(hands, self._faces)[0]
        found = [self._annotate(hand) for hand in track(closed, "Annotating contact")]
        return ContactMaps(
            np.stack([contact.object for contact in found]),
            np.stack([contact.body[: self._n] for contact in found]),
        )
