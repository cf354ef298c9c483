"""Which objects are for training, which for validation, which for testing (paper S.9.1)."""

from __future__ import annotations

from collections.abc import Collection

SPLITS = ("train", "val", "test")
# Ends the names of subjects, objects and sequences as a mirror shows them.
MIRRORED_SUFFIX = "_mirrored"


def split_of(name: str, val_objects: Collection[str], test_objects: Collection[str]) -> str:
    """train, val or test: where an object belongs; its mirror image belongs where it does."""
    name = name.removesuffix(MIRRORED_SUFFIX)
    return "val" if name in val_objects else "test" if name in test_objects else "train"
