"""Places that a command writes to, tried before it starts."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path

from grabnet.errors import UserError


def refuse_unwritable(path: str | Path, name: str, is_folder: bool) -> None:
    """Try to write where a file or folder will be; what is there stays as it is.

    Args:
        path: of the file or folder, which need not exist.
        name: of the option or config value that names it.
        is_folder: whether it will be a folder.

    Raises:
        UserError: it cannot be there.
    """
    path = Path(path).expanduser().absolute()
    try:
        if not is_folder and path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        inside = path if is_folder else path.parent
        # Not the folder itself: in its name may be the time, which will be another when it is made.
        tempfile.TemporaryDirectory(dir=next(p for p in (inside, *inside.parents) if _exists(p))).cleanup()
        _exists(path)
    except OSError as error:
        raise UserError(f"{path} cannot be written to ({error.strerror}): choose another {name}.") from None


def _exists(path: Path) -> bool:
    """Whether a file, folder or link is there.

    Raises:
        OSError: none can be, such as of a name that is too long.
    """
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True
