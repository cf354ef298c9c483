"""Which frames are for training, which for validation, which for testing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from grabnet.cli.checks import one_of
from grabnet.data.frames import FramesStore
from grabnet.errors import UserError

SPLITS = ("train", "val", "test")
ASPECTS = ("object", "subject", "sequence")
# Ends the names of subjects, objects and sequences as a mirror shows them.
MIRRORED_SUFFIX = "_mirrored"


@dataclass(frozen=True)
class Split:
    """Frames held out by name, mirror images with what they mirror; the values of `configs/data/split/*.yaml`.

    Args:
        by: what the names are of: "object" (paper S.9.1), "subject" or "sequence".
        val: names held out for validation.
        test: names held out for testing; every other one is for training.

    Raises:
        UserError: another `by`, or a name in both lists.
    """

    by: str
    val: Sequence[str]
    test: Sequence[str]

    def __post_init__(self):
        one_of(self, "split.", by=ASPECTS)
        if both := sorted(set(self.val) & set(self.test)):
            raise UserError(f"split.val and split.test both name {both[0]}: it can be in one of them.")

    def of(self, **names: str) -> str:
        """train, val or test.

        Args:
            names: of the frame's object, subject and sequence.
        """
        name = names[self.by].removesuffix(MIRRORED_SUFFIX)
        return "val" if name in self.val else "test" if name in self.test else "train"

    def names(self, store: FramesStore) -> list[str]:
        """Names of the store's objects, subjects or sequences, whichever it is split by."""
        return getattr(store, f"{self.by}s")

    def members(self, store: FramesStore, split: str) -> Tensor:
        """Numbers (N,) of the store's frames that are for `split`, in order."""
        is_member = torch.tensor([self.of(**{self.by: name}) == split for name in self.names(store)])
        return is_member[getattr(store.frames, self.by)].nonzero().squeeze(1)
