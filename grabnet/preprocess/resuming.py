"""Continuing a store: made of the same files only."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from grabnet.data.frames import read_header, shard_names, shard_path
from grabnet.data.splits import MIRRORED_SUFFIX
from grabnet.errors import UserError
from grabnet.io.files import existing, sha256
from grabnet.preprocess.recordings import RecordingSource


def shards_done(store: Path, recordings: RecordingSource, names: Collection[str], mirrored: bool) -> set[str]:
    """Those of the recordings whose shards are there, made of the files as they are.

    Args:
        store: folder of the shards.
        recordings: the data set.
        names: of all recordings.
        mirrored: whether each has a second shard, of its mirror image.

    Raises:
        UserError: a shard of a recording that is no more, or of files that have changed.
    """
    digests: dict[str, str] = {}
    shards = shard_names(store)
    known = {*names, *(name + MIRRORED_SUFFIX for name in names)}
    for name in shards:
        path = shard_path(store, name)
        if name not in known:
            raise UserError(f"{path} is of a recording that {recordings.folder} does not hold: delete it.")
        for file, digest in read_header(path, {"inputs": {str: str}})["inputs"].items():
            now = recordings.folder / file
            if file not in digests:
                digests[file] = sha256(existing(now, "File"))
            if digests[file] != digest:
                raise UserError(
                    f"{path} was made when {now} was another file: delete the shard to have it made again, or choose "
                    f"another output=."
                )
    there, endings = set(shards), ("", MIRRORED_SUFFIX) if mirrored else ("",)
    return {name for name in names if all(name + ending in there for ending in endings)}
