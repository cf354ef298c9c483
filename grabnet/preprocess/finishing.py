"""From shards to a data set: subjects, objects, records, pictures, and the store's card at last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from grabnet.body.anatomy import FINGERS
from grabnet.body.hand import HandModel
from grabnet.data.batches import BatchAssembler
from grabnet.data.frames import finish_store, read_frames
from grabnet.data.measuring import contact_share
from grabnet.data.objects import OBJECT_MESHES, ObjectSet
from grabnet.data.sources.base import place_mesh
from grabnet.data.splits import MIRRORED_SUFFIX, Split
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh, save_mesh
from grabnet.io.provenance import versions
from grabnet.io.state import Kind
from grabnet.preprocess.card import Card
from grabnet.preprocess.grasp_track import mirror_image, mirrored
from grabnet.preprocess.recordings import RecordingSource

# What headers of shards must say to be counted.
HEADER: Kind = {
    "template": str,
    "inputs": {str: str},
    "intent": str,
    "counts": {"waterfall": {"in all": int, "*": int}, "fingers": dict.fromkeys(("frames", *FINGERS, "palm"), int)},
}  # fmt: skip
# Headers of shards (`read_header`) by name.
Headers = Mapping[str, Mapping[str, Any]]


def other_hands(headers: Headers) -> dict[str, str]:
    """Recordings whose hand is not their subject's, with the reason: most of that subject have another template."""
    votes: dict[str, Counter[str]] = {}
    for header in headers.values():
        votes.setdefault(header["subject"], Counter())[header["template"]] += 1
    own = {subject: max(sorted(votes), key=lambda path: votes[path]) for subject, votes in votes.items()}
    return {
        name: f"{name} has its hand from {header['template']}, others of its subject from {own[header['subject']]}."
        for name, header in headers.items()
        if header["template"] != own[header["subject"]]
    }


@dataclass(frozen=True)
class Finishing:
    """Finishes the data set in a folder when called.

    Args:
        root: the folder.
        recordings: what its shards are of.
        split: which frames are for training, validation and testing.
        contact_distance: metres within which a hand vertex touches, in the picture.
        cache_dir: of signed-distance grids; the user's cache folder when omitted.
        pictures: draw the waterfall and the hand coloured by its contact in frames for training.
    """

    root: Path
    recordings: RecordingSource
    split: Split
    contact_distance: float
    cache_dir: str | None
    pictures: bool

    def __call__(self, headers: Headers, failed: Collection[str], recipe: Mapping[str, Any]) -> None:
        """Finish.

        Args:
            headers: of all shards. failed: recordings that gave none. recipe: of the shards.

        Raises:
            UserError: hand templates that don't fit the model.
        """
        v_template = self._templates(headers)
        splits = {
            name: self.split.of(object=header["object"], subject=header["subject"], sequence=name)
            for name, header in headers.items()
        }
        objects = sorted({header["object"] for header in headers.values()})
        hashes = {name: self._place_object(name) for name in objects}
        facts = {
            "recipe": recipe,
            "versions": versions(),
            "objects_sha256": hashes,
            "split": asdict(self.split),
        }
        card = Card(headers, splits, failed, facts)
        card.write(self.root)
        if self.pictures:
            from grabnet.preprocess.pictures import draw_contact, draw_waterfall

            draw_waterfall(card.waterfall, self.root / "waterfall.png")
            contact = self._contact(headers, splits, v_template)
            if contact is not None:
                draw_contact(self._hand, contact, self.root / "contact.png")
        finish_store(self.root / "frames", self._hand.fingerprint, v_template, objects, facts)

    @cached_property
    def _hand(self) -> HandModel:
        return self.recordings.hand()

    def _templates(self, headers: Headers) -> dict[str, Tensor]:
        """(V, 3) rest right hand of each subject, by name."""
        paths = {header["subject"]: header["template"] for header in headers.values()}  # one each: see `other_hands`
        templates = {}
        for subject, path in sorted(paths.items()):
            rest = self.recordings.rest(path)
            if (n := len(rest)) != (of_model := len(self._hand.v_template)):
                raise UserError(f"{self.recordings.folder / path} has {n} vertices, the hand model {of_model}.")
            templates[subject] = mirrored(rest) if subject.endswith(MIRRORED_SUFFIX) else rest
        return templates

    def _place_object(self, name: str) -> str:
        """Put an object's mesh, or its mirror image, where training looks for it; its hash."""
        source = self.recordings.objects()[name.removesuffix(MIRRORED_SUFFIX)]
        if not name.endswith(MIRRORED_SUFFIX):
            return place_mesh(self.root, name, source)
        target = self.root / OBJECT_MESHES / f"{name}.ply"
        save_mesh(target, mirror_image(load_mesh(source)))
        return load_mesh(target).sha256

    def _contact(self, headers: Headers, splits: Mapping[str, str], v_template: dict[str, Tensor]) -> Tensor | None:
        """(V,) share of training frames in which each hand vertex touches; None where there are none."""
        kept = [
            name
            for name, header in headers.items()
            if header["counts"]["fingers"]["frames"] and splits[name] == "train"
        ]
        if not kept:
            return None
        objects = sorted({headers[name]["object"] for name in kept})
        object_set = ObjectSet.load(self.root / OBJECT_MESHES, objects, cache_dir=self.cache_dir)
        assembler = BatchAssembler(self._hand, torch.stack(list(v_template.values())), object_set)
        frames = read_frames(self.root / "frames", list(v_template), objects, kept)
        return contact_share(frames, assembler, self.contact_distance)
