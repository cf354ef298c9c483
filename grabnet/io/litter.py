"""What killed processes left half-written: found by name and lock, and removed by the next start of the same work."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from fnmatch import fnmatchcase as fnmatch
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows, where a file that is open cannot be removed anyway
    fcntl = None

# What tempfile adds to a name.
_RANDOM = re.compile(r"-[a-z0-9_]{8}")


@contextmanager
def temporary_beside(path: Path, is_folder: bool = False) -> Iterator[Path]:
    """An empty hidden file or folder beside `path`, of its name and suffix; removed when the block ends.

    It is locked meanwhile, so that `clear_litter` can tell it from what a killed process left.
    """
    handle, temporary = _locked(path, is_folder)
    try:
        yield temporary
    finally:
        _remove(temporary)
        if handle is not None:
            os.close(handle)


def clear_litter(folder: str | Path, *names: str, contents: Sequence[str] = ()) -> None:
    """Remove what processes that were killed left half-written of files of these names below a folder.

    Only what was made by `temporary_beside` and is in use by no process. A folder is removed if it holds nothing but
    files like `contents`.

    Args:
        folder: that exists or not.
        names: of files, which may be patterns, as may the folders before them.
        contents: of temporary folders, as patterns.
    """
    for place in {Path(name).parent for name in names}:
        sought = {Path(name).name for name in names if Path(name).parent == place}
        patterns = [name for name in sought if "*" in name]
        for path in Path(folder).glob(str(place / ".*-????????*")):
            name = path.stem[1:-9] + path.suffix
            is_sought = name in sought or any(fnmatch(name, pattern) for pattern in patterns)
            if is_sought and _RANDOM.fullmatch(path.stem[-9:]) and _is_ours(path, contents):
                with contextlib.suppress(OSError), _only_user(path):
                    _remove(path)


def _is_ours(path: Path, contents: Sequence[str]) -> bool:
    if path.is_symlink() or not path.is_dir():
        return path.is_file() and not path.is_symlink()
    files = [file.relative_to(path) for file in path.rglob("*") if not file.is_dir()]
    return bool(contents) and all(
        any(place.match(pattern) for place in (file, *file.parents) for pattern in contents) for file in files
    )


def _locked(path: Path, is_folder: bool) -> tuple[int | None, Path]:
    """A new file or folder, and the handle that its lock is held by; None where there are no such locks."""
    names = {"prefix": f".{path.stem}-", "suffix": path.suffix, "dir": path.parent}
    while True:
        if is_folder:
            name = tempfile.mkdtemp(**names)
        else:
            handle, name = tempfile.mkstemp(**names)
            os.close(handle)
        if fcntl is None:
            return None, Path(name)
        handle = os.open(name, os.O_RDONLY)
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        # Between its making and its locking another process may have taken it for litter.
        if Path(name).exists():
            return handle, Path(name)
        os.close(handle)


@contextmanager
def _only_user(path: Path) -> Iterator[None]:
    """Raise an OSError where another process has the file or folder in use."""
    if fcntl is None:
        yield
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(handle)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
