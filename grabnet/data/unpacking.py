"""Unpacking the releases of GRAB and GrabNet: zip files whose names hold the folder they belong in, none trusted."""

from __future__ import annotations

import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from grabnet.cli.progress import track
from grabnet.errors import UserError
from grabnet.io.files import existing, replacing

# Bytes that one archive may unpack to; the frames that GrabNet trains on take 19 GB, GRAB's largest subject less.
MAX_BYTES = 64 << 30
# One archive may hold the 320,000 frames that GrabNet trains on.
MAX_MEMBERS = 1_000_000


def unpack(downloads: str | Path, root: str | Path, max_bytes: int = MAX_BYTES) -> list[str]:
    """Unpack every `*.zip` in `downloads` below `root`: `grab__s1.zip` into `grab/s1`.

    Files that are there already, whole, are kept, so that a stopped run can be started again. An archive is looked
    through before anything of it is written; one that can't be used is reported, and the others go on.

    Args:
        downloads: folder of the archives; or one archive, which, if its name has no `__`, is unpacked into `root`.
        root: where the folders go.
        max_bytes: that one archive may unpack to.

    Returns:
        a sentence for each archive that failed.

    Raises:
        UserError: no such folder or archive, or no zip file in it.
    """
    downloads, root = existing(downloads, "Folder of downloads"), Path(root)
    is_one = downloads.is_file()
    archives = [downloads] if is_one else sorted(downloads.glob("*.zip"))
    if not archives:
        raise UserError(f"{downloads} holds no zip file: download GRAB into it first.")
    failures = []
    for archive in archives:
        try:
            folder = root if is_one and "__" not in archive.stem else target_folder(archive, root)
            unpack_archive(archive, folder, root, max_bytes)
        except UserError as error:
            failures.append(str(error))
    return failures


def unpack_archive(path: Path, folder: Path, root: Path, max_bytes: int = MAX_BYTES) -> None:
    """Unpack one archive into a folder, which lies in `root`; see `unpack`.

    Raises:
        UserError: damaged, encrypted, too large, or a member that is a link or leads out of its folder.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            wanted = list(_checked(path, archive, folder, root, max_bytes))
            missing = [(member, file) for member, file in wanted if not _is_whole(file, member.file_size)]
            root.mkdir(parents=True, exist_ok=True)
            needed, free = sum(member.file_size for member, _ in missing), shutil.disk_usage(root).free
            if needed > free:
                raise UserError(f"{path} needs {needed:,} bytes, {root} has {free:,} left: free some space.")
            for member, file in track(missing, f"Unpacking {path.name}"):
                with archive.open(member) as source, replacing(file) as temporary, temporary.open("wb") as target:
                    shutil.copyfileobj(source, target, 1 << 20)
    except (zipfile.BadZipFile, zlib.error, NotImplementedError, EOFError) as error:
        raise UserError(f"{path} is no whole zip file ({error}): download it again.") from None


def target_folder(path: Path, root: Path) -> Path:
    """Where an archive belongs: the parts of its name between `__`.

    Raises:
        UserError: a name with parts that are no plain folder names.
    """
    parts = path.stem.split("__")
    if not all(part.strip(". ") and not set(part) & set("/\\:\0") for part in parts):
        raise UserError(f"{path} has a name that holds no folder; GRAB's are like grab__s1.zip.")
    return root.joinpath(*parts)


def _checked(
    path: Path, archive: zipfile.ZipFile, folder: Path, root: Path, max_bytes: int
) -> Iterator[tuple[zipfile.ZipInfo, Path]]:
    """Every file of the archive and where it goes."""
    members = [member for member in archive.infolist() if not member.is_dir()]
    if len(members) > MAX_MEMBERS:
        raise UserError(f"{path} holds {len(members):,} files, more than the {MAX_MEMBERS:,} that are unpacked.")
    # Sizes as declared: reading a member ends there, whatever is packed in it.
    if (size := sum(member.file_size for member in members)) > max_bytes:
        raise UserError(f"{path} unpacks to {size:,} bytes; at most {max_bytes:,} are written.")
    inside = root.resolve()
    for member in members:
        name, kind = member.orig_filename, stat.S_IFMT(member.external_attr >> 16)
        parts = PurePosixPath(name.replace("\\", "/"))
        file = folder.joinpath(*parts.parts) if not parts.is_absolute() else Path(name)
        if parts.is_absolute() or ".." in parts.parts or set(name) & set(":\0\\"):
            raise UserError(f"{path} holds {name!r}, which leads out of {folder}: nothing of it was unpacked.")
        if kind not in (0, stat.S_IFREG):
            raise UserError(f"{path} holds {name!r}, which is a link or device: nothing of it was unpacked.")
        if member.flag_bits & 1:
            raise UserError(f"{path} is encrypted: unpack it by hand into {folder}.")
        if not file.resolve().is_relative_to(inside):
            raise UserError(f"{path} would be unpacked through a link to {file.resolve()}, outside {root}: remove it.")
        yield member, file


def _is_whole(file: Path, size: int) -> bool:
    """Files are moved into place when complete, so that one of the right size is whole."""
    return file.is_file() and not file.is_symlink() and file.stat().st_size == size
