"""glTF 2.0, as .gltf and .glb: the triangles of its scene (specification 2.0, sections 3 to 5).

Only geometry is read. What a file requires and this reader does not do is refused by name.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator

import numpy as np

from grabnet.geometry.formats.accessors import Accessors
from grabnet.geometry.formats.geometry import MAX_FACES, FormatError, Geometry
from grabnet.geometry.formats.json_values import array, extensions_of, item, items, whole

# Extensions that leave geometry as it is, or that are read (quantised attributes).
_HARMLESS = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_")
_HARMLESS += (_VISIBILITY := "KHR_node_visibility",)  # read: what it hides is left out
# Extensions that move or multiply what a node shows, whether a file lists them or not.
_OF_NODES = ("EXT_mesh_gpu_instancing",)
_DRACO = "KHR_draco_mesh_compression"
_READ_VERSIONS = re.compile(r"[01](\.\d+)?|2(\.0)?")
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_MOST_NODES = 100_000


def read(data: bytes, fetch: Callable[[str], bytes]) -> Geometry:
    """Everything that the default scene shows, in the file's frame and units; points and lines have no faces.

    Args:
        data: of a .gltf or .glb file.
        fetch: bytes of a buffer that lies elsewhere, by its URI.

    Raises:
        FormatError: glTF other than 2.0, damaged, ended early, extensions that are not read, skeletons and morphs,
            transformations that are not finite.
    """
    text, binary = _chunks(data) if data.startswith(b"glTF") else (data, None)
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        raise FormatError("its JSON is damaged: export it again") from None
    if not isinstance(document, dict):
        raise FormatError("its JSON is no object")
    _check_version(document)
    _check_extensions(document)
    accessors = Accessors(document, binary, fetch)
    vertices, faces, n = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    shown = 0
    for node, matrix in _shown(document):
        for points, triangles in _primitives(document, accessors, node):
            vertices.append(points @ matrix[:3, :3].T + matrix[:3, 3])
            # A mirror image keeps its outside outside.
            faces.append(n + (triangles if np.linalg.det(matrix[:3, :3]) >= 0 else triangles[:, ::-1]))
            n += len(points)
            if n > 3 * MAX_FACES or (shown := shown + len(triangles)) > MAX_FACES:
                raise FormatError(f"it shows more than {MAX_FACES:,} faces: simplify it")
    return Geometry(np.concatenate(vertices), np.concatenate(faces))


def _chunks(data: bytes) -> tuple[bytes, bytes | None]:
    """JSON and binary chunk of a .glb file."""
    if (version := int.from_bytes(data[4:8], "little")) != 2:
        raise FormatError(f"it is glTF {version}: export it as glTF 2.0")
    chunks, at = {}, 12
    while at + 8 <= len(data):
        size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
        if at + 8 + size > len(data):
            raise FormatError("it ends within a chunk: export it again")
        chunks.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if b"JSON" not in chunks:
        raise FormatError("it has no JSON chunk: export it again")
    return chunks[b"JSON"], chunks.get(b"BIN\0")


def _check_version(document: dict) -> None:
    asset = document.get("asset", {})
    version = asset.get("version") if isinstance(asset, dict) else None
    named = isinstance(document.get("meshes"), dict) or isinstance(document.get("buffers"), dict)
    if named or str(version if version is not None else 2).split(".")[0] != "2":
        raise FormatError("it is glTF 1: export it as glTF 2.0" if named else f"it is glTF {version!s:.10}, not 2.0")
    least = asset.get("minVersion", "2.0") if isinstance(asset, dict) else "2.0"
    if not _READ_VERSIONS.fullmatch(str(least)):
        raise FormatError(f"it can be read only as glTF {least!s:.10} or later: export it as glTF 2.0")


def _check_extensions(document: dict) -> None:
    for name in items(document, "extensionsRequired"):
        if not str(name).startswith(_HARMLESS):
            raise FormatError(f"it requires the extension {name!s:.60}, which is not read: export it without")
    for name in items(document, "extensionsUsed"):
        if name in _OF_NODES:
            raise _unread(name)


def _unread(extension: str) -> FormatError:
    return FormatError(f"it uses the extension {extension}, which is not read: export it without")


def _shown(document: dict) -> Iterator[tuple[dict, np.ndarray]]:
    """Each node with a mesh that the scene shows, with the (4, 4) matrix that places it."""
    nodes = items(document, "nodes")
    if items(document, "scenes"):
        roots = items(item(document, "scenes", document.get("scene", 0)), "nodes")
    else:
        children = {child for node in nodes if isinstance(node, dict) for child in items(node, "children")}
        roots = [number for number in range(len(nodes)) if number not in children]
    waiting, seen = [(number, np.eye(4)) for number in reversed(roots)], set()
    while waiting:
        number, parent = waiting.pop()
        node = item(document, "nodes", number)
        if number in seen:
            raise FormatError(f"node {number} is below two others, or below itself: export it again")
        if len(seen) == _MOST_NODES:
            raise FormatError(f"it has more than {_MOST_NODES:,} nodes: merge its parts")
        seen.add(number)
        extensions = extensions_of(node, f"node {number}")
        if used := [name for name in _OF_NODES if name in extensions]:
            raise _unread(used[0])
        if not _is_visible(extensions, number):
            continue
        matrix = parent @ _matrix(node, number)
        waiting += [(child, matrix) for child in reversed(items(node, "children"))]
        if "mesh" in node:
            if "skin" in node:
                raise FormatError(f"node {number} is moved by a skeleton (skin): export it with its pose applied")
            yield node, matrix


def _is_visible(extensions: dict, number: int) -> bool:
    """Whether a node and what is below it are shown."""
    visibility = extensions.get(_VISIBILITY, {})
    visible = visibility.get("visible", True) if isinstance(visibility, dict) else None
    if not isinstance(visible, bool):
        raise FormatError(f"the visibility of node {number} is damaged: export it again")
    return visible


def _matrix(node: dict, number: int) -> np.ndarray:
    """(4, 4) matrix from a node to its parent."""
    where = f"node {number}"
    if "matrix" in node:
        matrix = array(node["matrix"], 16, f"the matrix of {where}").reshape(4, 4).T
        if np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
            raise FormatError(f"the matrix of {where} is a projection: export it again")
        return matrix
    x, y, z, w = array(node.get("rotation", [0, 0, 0, 1]), 4, f"the rotation of {where}")
    squared = x * x + y * y + z * z + w * w
    if not squared > 0:
        raise FormatError(f"the rotation of {where} is zero: export it again")
    matrix = np.eye(4)
    turn = np.array([[y * y + z * z, w * z - x * y, -w * y - x * z],
                     [-w * z - x * y, x * x + z * z, w * x - y * z],
                     [w * y - x * z, -w * x - y * z, x * x + y * y]])  # fmt: skip
    matrix[:3, :3] = (np.eye(3) - 2 / squared * turn) * array(node.get("scale", [1, 1, 1]), 3, f"the scale of {where}")
    matrix[:3, 3] = array(node.get("translation", [0, 0, 0]), 3, f"the translation of {where}")
    return matrix


def _primitives(document: dict, accessors: Accessors, node: dict) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Points (P, 3) and triangles (T, 3) of the parts of a node's mesh."""
    mesh, where = item(document, "meshes", node["mesh"]), f"mesh {node['mesh']}"
    morphed = any(items(node if "weights" in node else mesh, "weights"))  # a node's go before its mesh's
    for primitive in items(mesh, "primitives"):
        if not isinstance(primitive, dict) or not isinstance(primitive.get("attributes", {}), dict):
            raise FormatError(f"{where} has a part that is damaged: export it again")
        if "POSITION" not in primitive.get("attributes", {}):
            continue
        position = primitive["attributes"]["POSITION"]
        indices = primitive.get("indices")
        compressed = _DRACO in extensions_of(primitive, where)
        if compressed and not all(accessors.is_stored(n) for n in (position, indices) if n is not None):
            raise FormatError(f"{where} is compressed with {_DRACO}, which is not read: export it without")
        if primitive.get("targets") and morphed:
            raise FormatError(f"{where} is changed by morph targets (weights): export it with its shape applied")
        points = accessors.values(position, "VEC3")
        mode = whole(primitive.get("mode", _TRIANGLES), f"the mode of {where}")
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            yield points, np.zeros((0, 3), np.int64)
            continue
        corners = np.arange(len(points)) if indices is None else accessors.values(indices, "SCALAR")[:, 0]
        if corners.size and not corners.max() < len(points):
            raise FormatError(f"{where} has faces that name vertices beyond its {len(points)}: export it again")
        yield points, _triangles(corners.astype(np.int64), mode, where)


def _triangles(corners: np.ndarray, mode: int, where: str) -> np.ndarray:
    if mode == _TRIANGLES:
        if len(corners) % 3:
            raise FormatError(f"{where} has {len(corners)} corners, not three a face: export it again")
        return corners.reshape(-1, 3)
    if mode == _FAN:
        return np.stack([corners[1:-1], corners[2:], np.broadcast_to(corners[:1], len(corners[2:]))], 1)
    strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], 1)
    strip[1::2] = strip[1::2, [1, 0, 2]]
    return strip
