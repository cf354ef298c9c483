"""Files that lie among others by accident, known by their names: what systems add, and copies."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from grabnet.errors import printable

# Bytes of a name that leave room, of the 255 that disks have, for what is added to make a temporary one of it.
LONGEST_NAME = 240
# Folders that systems add to archives and disks.
_OF_SYSTEMS = {"__MACOSX", "@eaDir"}
# Not what has nothing but dots before its ending: `...obj`.
_HIDDEN = re.compile(r"\.(?!\.*(\.\w+)?\Z)|\.\w+\Z")
_WORD = r"(copy|kopie|copie|copia|cópia)"
_COPY = re.compile(
    rf".+( \(\d{{1,3}}\)| ?\({_WORD}( \d+)?\)|( -)? {_WORD}( \d+)?| - {_WORD} \(\d+\))"  # mug (1), mug copy 2
    rf"|.+ \((another|\d+(st|nd|rd|th)) copy\)|{_WORD}( \(\d+\))? (of|von|van|de|di) .+"  # mug (3rd copy), Copy of mug
    r"|.+conflicted copy.*|.+\.sync-conflict-.+",  # what programs that synchronise folders keep beside the original
    re.IGNORECASE,
)
# "mug 2", "mug(1)": copies where there is a mug beside them.
_NUMBERED = re.compile(r"(.+?)(?: \d{1,3}|\(\d{1,3}\))")

log = logging.getLogger(__name__)


def is_hidden(name: str | Path) -> bool:
    """Whether a file or a folder on its relative path is hidden or a system's own: `._mug.npz`, `__MACOSX/mug.npz`."""
    parts = PurePosixPath(str(name).replace("\\", "/")).parts
    return any(part in _OF_SYSTEMS or _HIDDEN.match(part) for part in parts)


def is_copy(name: str | Path) -> bool:
    """Whether a file is a copy by its name: what browsers and systems make of a second download or a duplicate."""
    return _COPY.fullmatch(PurePosixPath(str(name)).stem) is not None


def originals(files: Iterable[Path], within: Path) -> list[Path]:
    """Files that are neither hidden nor copies, in order; each copy is named in a warning, as it is left out.

    Args:
        files: below `within`.
        within: folder whose own name does not count.
    """
    there = sorted(file for file in files if not is_hidden(file.relative_to(within)))
    copies = [file for file in there if is_copy(file) or _numbered(file) in there]
    for file in copies:
        log.warning("%s is left out: by its name it is a copy. Rename it if it is not.", printable(str(file)))
    return [file for file in there if file not in copies]


def _numbered(file: Path) -> Path | None:
    """What a file is the second of, where its name has such a number."""
    found = _NUMBERED.fullmatch(file.stem)
    return None if found is None else file.with_name(found[1] + file.suffix)
