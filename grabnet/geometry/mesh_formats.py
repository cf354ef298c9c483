"""Reading mesh files of several formats into plain vertices and faces; files are told apart by their content."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import trimesh

from grabnet.errors import UserError
from grabnet.io.files import existing


def _looks_like_stl(data: bytes) -> bool:
    if len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little"):
        return True
    return data.lstrip()[:5].lower() == b"solid" and b"\0" not in data[:512]


def _looks_like_obj(data: bytes) -> bool:
    return b"\0" not in data[:4096] and any(line.split(None, 1)[:1] == [b"v"] for line in data.splitlines())


_LOOKS_LIKE: dict[str, Callable[[bytes], bool]] = {
    ".obj": _looks_like_obj,
    ".ply": lambda data: data.startswith(b"ply"),
    ".stl": _looks_like_stl,
    ".off": lambda data: data.lstrip()[:4].upper() in (b"OFF\n", b"OFF\r", b"OFF ", b"COFF") or data.startswith(b"#"),
    ".glb": lambda data: data.startswith(b"glTF"),
    ".gltf": lambda data: data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"),
}


def read_geometry(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and faces (F, 3) of everything in the file, scenes flattened with their transforms.

    Nothing but geometry is read, and nothing outside the file's own folder.

    Raises:
        UserError: unknown extension, content of another format, unreadable, or no vertices.
    """
    parts = [part for part in _parts(path) if len(part.vertices)]
    if not parts:
        raise UserError(f"{path} is empty: it holds no vertices.")
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    faces = [_faces(part) + offset for part, offset in zip(parts, offsets, strict=True)]
    return np.concatenate([part.vertices for part in parts]), np.concatenate(faces)


def _parts(path: Path) -> list[trimesh.Trimesh | trimesh.PointCloud]:
    """Every mesh and point set of the file, in the file's frame."""
    suffix = path.suffix.lower()
    if suffix not in _LOOKS_LIKE:
        raise UserError(
            f"{path} has the extension {suffix or '(none)'}; meshes are read from {', '.join(_LOOKS_LIKE)}."
        )
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror}).") from None
    if not data.strip():
        raise UserError(f"{path} is empty.")
    if not _LOOKS_LIKE[suffix](data):
        others = [name for name, test in _LOOKS_LIKE.items() if name not in (".obj", suffix) and test(data)]
        remedy = f"it looks like {others[0]}, rename it" if others else "export it again or give it its true extension"
        raise UserError(f"{path} does not hold what its extension {suffix} says: {remedy}.")
    logging.getLogger("trimesh").setLevel(logging.ERROR)
    try:
        scene = trimesh.load_scene(
            BytesIO(data),
            file_type=suffix[1:],
            resolver=_buffers(path, data) if suffix == ".gltf" else {},
            process=False,
            skip_materials=True,
            maintain_order=True,
        )
        return [part for part in scene.dump() if isinstance(part, trimesh.Trimesh | trimesh.PointCloud)]
    except (UserError, MemoryError):
        raise
    except Exception as error:  # a broken file can fail anywhere in a parser: all of it means unreadable
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise UserError(f"{path} is not a readable {suffix} file ({reason}).") from None


def _buffers(path: Path, data: bytes) -> dict[str, bytes]:
    """Bytes of the files that a glTF refers to; only files in its own folder or below are touched."""
    folder = path.parent.resolve()
    found = {}
    for buffer in json.loads(data).get("buffers", []):
        uri = buffer.get("uri", "data:")
        if uri.startswith("data:"):
            continue
        target = (folder / unquote(uri)).resolve()
        if not target.is_relative_to(folder):
            raise UserError(f"{path} refers to {uri}, outside its own folder: save it as .glb, which holds everything.")
        found[uri] = existing(target, f"{path.name} refers to a file that is not there: buffer").read_bytes()
    return found


def _faces(part: trimesh.Trimesh | trimesh.PointCloud) -> np.ndarray:
    return np.asarray(getattr(part, "faces", np.zeros((0, 3), np.int64)), np.int64).reshape(-1, 3)
