"""Going on with a store that was begun: with the same recipe and files only, and by one process at a time."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from grabnet.data.frames import read_header, shard_names, shard_path
from grabnet.data.splits import MIRRORED
from grabnet.errors import UserError
from grabnet.io.files import existing, leftovers, sha256, write_json
from grabnet.io.recipes import difference
from grabnet.preprocess.recordings import Recordings

LOCK = ".lock"  # stays in the store; only the run that holds the system's lock on it writes there


@contextmanager
def alone_in(store: Path) -> Iterator[None]:
    """Have the store's folder for this process alone.

    Raises:
        UserError: another process has it, or it cannot be made.
    """
    try:
        store.mkdir(parents=True, exist_ok=True)
        lock = FileLock(store / LOCK).acquire(timeout=0)
    except Timeout:
        raise UserError(f"Another run is at work on {store}: wait for it, or choose another output=.") from None
    except OSError as error:
        raise UserError(f"{store} cannot be used ({error.strerror}): choose another output=.") from None
    with lock:
        yield


def begin(store: Path, recipe: dict[str, Any]) -> None:
    """Write the recipe of its shards down in a new store; of one begun earlier remove what a killed run left
    half-written.

    Raises:
        UserError: it was begun with another recipe.
    """
    path, remedy = store / "recipe.json", f"delete {store}, or choose another output="
    if not path.exists():
        if shard_names(store):
            raise UserError(f"{store} holds frames that were not made from recordings: {remedy}.")
        write_json(path, recipe)
        return
    if changed := difference(json.loads(path.read_text()), recipe):
        raise UserError(f"{store} was {changed}: {remedy}.")
    for leftover in leftovers(store, "*.*", "shards/*/*.*"):
        leftover.unlink()


def shards_done(store: Path, recordings: Recordings, names: Collection[str], mirrored: bool) -> set[str]:
    """Those of the recordings whose shards are there, made of the files as they are.

    Args:
        names: of all recordings. mirrored: whether each has a second shard, of its mirror image.

    Raises:
        UserError: a shard of a recording that is no more, or of files that have changed.
    """
    digests: dict[str, str] = {}
    shards = shard_names(store)
    known = {*names, *(name + MIRRORED for name in names)}
    for name in shards:
        path = shard_path(store, name)
        if name not in known:
            raise UserError(f"{path} is of a recording that {recordings.folder} does not hold: delete it.")
        for file, digest in read_header(path)["inputs"].items():
            now = recordings.folder / file
            if file not in digests:
                digests[file] = sha256(existing(now, "File"))
            if digests[file] != digest:
                raise UserError(
                    f"{path} was made when {now} was another file: delete the shard to have it made anew, or choose "
                    f"another output=."
                )
    there, endings = set(shards), ("", MIRRORED) if mirrored else ("",)
    return {name for name in names if all(name + ending in there for ending in endings)}
