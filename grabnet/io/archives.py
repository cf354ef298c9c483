"""Opening zip files that others made: looked through before anything of them is unpacked."""

from __future__ import annotations

import lzma
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from grabnet.errors import UserError
from grabnet.io.files import DISK_ERRORS, existing_file
from grabnet.io.names import is_hidden

# What zipfile and its decompressors raise for a file that is not what it should be, besides OSErrors.
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    struct.error,
    ValueError,
    EOFError,
    KeyError,
    IndexError,
    NotImplementedError,
    RuntimeError,
    OverflowError,
)
# Others may take any amount of memory, and no archive of this field uses them.
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@contextmanager
def opened_archive(path: str | Path, what: str, remedy: str) -> Iterator[zipfile.ZipFile]:
    """An open zip file; whatever in it cannot be read within the block becomes a `UserError`.

    Args:
        path: of the file.
        what: it is not when it is damaged, as in "not a readable .npz file".
        remedy: what to do then; ends the sentence.

    Raises:
        UserError: no regular file, one that the system does not let read, or damaged.
    """
    path = existing_file(path, "Archive")
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except UserError:
        raise
    except DAMAGE as error:
        raise UserError(f"{path} is {what} ({' '.join(str(error).split())[:200]}): {remedy}.") from None
    except OSError as error:
        if error.filename == str(path):
            raise UserError(f"{path} cannot be read ({error.strerror}).") from None
        if error.errno in DISK_ERRORS:  # of a place that is written to within the block
            raise
        raise UserError(f"{path} is {what} ({error.strerror or error}): {remedy}.") from None


def members_of(archive: zipfile.ZipFile, path: str | Path, max_members: int, max_bytes: int) -> list[zipfile.ZipInfo]:
    """Files in an archive but hidden ones.

    Args:
        archive: open.
        path: its name, for messages.
        max_members: files that it may hold.
        max_bytes: that they may unpack to; a small archive can be made to unpack to any size.

    Raises:
        UserError: more or larger files; encrypted ones, two of one name, one without a name, or a compression other
            than zip's usual one.
    """
    members = [m for m in archive.infolist() if m.filename[-1:] != "/" and not is_hidden(m.filename)]
    if len(members) > max_members:
        raise UserError(f"{path} holds {len(members):,} files, more than the {max_members:,} that are read.")
    # Sizes as declared: reading a member ends there, whatever is packed in it.
    if (size := sum(member.file_size for member in members)) > max_bytes:
        raise UserError(f"{path} unpacks to {size:,} bytes; at most {max_bytes:,} are read.")
    seen: set[str] = set()
    for member in members:
        name = member.filename
        if not name.strip("/. "):
            raise UserError(f"{path} holds a file of the name {name!r}, which names none.")
        if name in seen:
            raise UserError(f"{path} holds two files {name!r}.")
        if member.flag_bits & 1:
            raise UserError(f"{path} is encrypted: unpack it by hand.")
        if member.compress_type not in _METHODS:
            raise UserError(f"{path} holds {name!r}, which is compressed by method {member.compress_type}; 8 is read.")
        seen.add(name)
    return members
