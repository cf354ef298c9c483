"""Unpacking the releases of GRAB and GrabNet: zip files whose names hold the folder they belong in, none trusted."""

from __future__ import annotations

import os
import shutil
import stat
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from grabnet.cli.progress import track
from grabnet.errors import UserError
from grabnet.io.archives import DAMAGE, members_of, opened_archive
from grabnet.io.files import DISK_ERRORS, existing, replacing
from grabnet.io.litter import clear_litter
from grabnet.io.names import LONGEST_NAME, originals

# Bytes that one archive may unpack to; the frames that GrabNet trains on take 19 GB, GRAB's largest subject less.
MAX_BYTES = 64 << 30
# One archive may hold the 320,000 frames that GrabNet trains on.
MAX_MEMBERS = 1_000_000
_LONGEST_PATH = 4000  # bytes, as file systems have them
_REMEDY = "download it again"


def unpack(downloads: str | Path, root: str | Path, max_bytes: int = MAX_BYTES) -> list[str]:
    """Unpack every `*.zip` in `downloads` below `root`: `grab__s1.zip` into `grab/s1`.

    Files that are there already, whole, are kept, so that a stopped run can be started again. An archive is looked
    through before anything of it is written; one that can't be used is reported, and the others go on. Hidden files and
    copies (`grab__s1 (1).zip`) are left out, of archives and in them.

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
    archives = [downloads] if is_one else originals(downloads.glob("*.zip"), downloads)
    if not archives:
        raise UserError(f"{downloads} holds no zip file: download GRAB into it first.")
    failures = []
    for archive in archives:
        try:
            folder = root if is_one and "__" not in archive.stem else target_folder(archive, root)
            unpack_archive(archive, folder, root, max_bytes)
        except UserError as error:
            failures.append(str(error))
        except OSError as error:
            # Of the place, which the next archive finds no better.
            if error.errno in DISK_ERRORS and error.filename != str(archive):
                raise
            failures.append(str(UserError(f"{archive} was not unpacked ({error}).")))
    return failures


def unpack_archive(path: Path, folder: Path, root: Path, max_bytes: int = MAX_BYTES) -> None:
    """Unpack one archive into a folder, which lies in `root`; see `unpack`.

    A file in it that is damaged is left out, and the others are unpacked.

    Raises:
        UserError: damaged, encrypted, too large; or a member that is a link, leads out of its folder, or cannot lie
            there. Nothing is unpacked then, but where only the content of some files is damaged.
    """
    damaged: list[str] = []
    with opened_archive(path, "no whole zip file", _REMEDY) as archive:
        members = list(_checked(path, archive, folder, root, max_bytes))
        missing = [(member, file) for member, file in members if not _is_whole(file, member.file_size)]
        root.mkdir(parents=True, exist_ok=True)
        needed, free = sum(member.file_size for member, _ in missing), shutil.disk_usage(root).free
        if needed > free:
            raise UserError(f"{path} needs {needed:,} bytes, {root} has {free:,} left: free some space.")
        names: dict[Path, list[str]] = {}
        for _, file in missing:
            names.setdefault(file.parent, []).append(file.name)
        for place, of_place in names.items():
            clear_litter(place, *of_place)
        for member, file in track(missing, f"Unpacking {path.name}"):
            try:
                with archive.open(member) as source, replacing(file) as temporary, temporary.open("wb") as target:
                    shutil.copyfileobj(source, target, 1 << 20)
            except DAMAGE as error:
                damaged.append(f"{member.filename!r} ({error})")
    if damaged:
        raise UserError(
            f"{path} is no whole zip file: {len(damaged)} of its {len(members)} files are damaged, the first of them "
            f"{damaged[0]}: {_REMEDY}."
        )


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
    places: dict[str, str] = {}
    inside = root.resolve()
    for member in members_of(archive, path, MAX_MEMBERS, max_bytes):
        name, kind = member.orig_filename, stat.S_IFMT(member.external_attr >> 16)
        parts = PurePosixPath(name.replace("\\", "/"))
        file = folder.joinpath(*parts.parts) if not parts.is_absolute() else Path(name)
        if parts.is_absolute() or ".." in parts.parts or set(name) & set(":\0\\"):
            raise UserError(f"{path} holds {name!r}, which leads out of {folder}: nothing of it was unpacked.")
        if kind not in (0, stat.S_IFREG):
            raise UserError(f"{path} holds {name!r}, which is a link or device: nothing of it was unpacked.")
        _check_place(path, name, parts, file, places)
        if not file.resolve().is_relative_to(inside):
            raise UserError(f"{path} would be unpacked through a link to {file.resolve()}, outside {root}: remove it.")
        yield member, file


def _check_place(path: Path, name: str, parts: PurePosixPath, file: Path, places: dict[str, str]) -> None:
    """Raise a `UserError` for a file that cannot lie where it belongs.

    Args:
        path: of the archive. name: of the file in it. parts: of its name. file: where it goes.
        places: what each name in the archive is so far, "file" or "folder"; this one's are added.
    """
    unpacked = f"{path} holds {name!r}, {{}}: nothing of it was unpacked."
    if max(len(os.fsencode(part)) for part in parts.parts) > LONGEST_NAME or len(os.fsencode(file)) > _LONGEST_PATH:
        raise UserError(unpacked.format("whose name is too long for a disk"))
    for place in (parts, *parts.parents[:-1]):
        kind = "file" if place == parts else "folder"
        if places.setdefault(str(place), kind) != kind or (kind == "file" and file.is_dir()):
            raise UserError(unpacked.format("which is both a file and a folder"))
    for above in file.parents:
        if above.exists():
            if not above.is_dir():
                raise UserError(unpacked.format(f"for which {above}, a file, is in the way"))
            break


def _is_whole(file: Path, size: int) -> bool:
    """Files are moved into place when complete, so that one of the right size is whole."""
    return file.is_file() and not file.is_symlink() and file.stat().st_size == size
