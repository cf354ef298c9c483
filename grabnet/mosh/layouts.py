"""Marker layouts: which label sits where on a body or an object, as YAML files that people can read and edit."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import existing, write_bytes

# Of each type of marker, the usual distance of its middle to the skin, metres (ref. 5).
DISTANCES = {"body": 0.0095, "face": 0.0, "finger": 0.0}
# Fewer than this many body markers don't determine where the pelvis is and how it is turned.
_FEWEST = 6
_ROUNDED = 1e-3  # by which weights may miss their range and sum
_DIGITS = 5  # of positions on objects, after the point


@dataclass(frozen=True)
class Attached:
    """A marker's place on the body.

    Attributes:
        label: as in captures, without prefix.
        type: body, face or finger.
        vertices: (3,) corners; three times the same one for a marker on a vertex.
        weights: (3,) barycentric.
        distance: of the marker's middle to the skin, metres.
    """

    label: str
    type: str
    vertices: tuple[int, int, int]
    weights: tuple[float, float, float]
    distance: float

    @classmethod
    def at(cls, label: str, type_: str, vertex: int, distance: float | None = None) -> Attached:
        """On a vertex, by default at the usual distance of its type."""
        return cls(label, type_, (vertex,) * 3, (1.0, 0.0, 0.0), DISTANCES[type_] if distance is None else distance)


@dataclass(frozen=True)
class Layout:
    """The markers of a body.

    Attributes:
        name: of the layout.
        n_vertices: of the body model that the places are on; other models have other vertices.
        markers: in the file's order.
    """

    name: str
    n_vertices: int
    markers: tuple[Attached, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(marker.label for marker in self.markers)

    @property
    def types(self) -> np.ndarray:
        """(M,) of the markers, as text."""
        return np.array([marker.type for marker in self.markers])

    def restricted(self, labels: Iterable[str], where: object) -> tuple[Layout, list[str]]:
        """The markers that a capture has, and sentences on those that either side lacks.

        Raises:
            UserError: a label that only differs by a slip from one of the layout; too few labels in common.
        """
        there = list(labels)
        if unknown := [label for label in there if label not in self.labels]:
            absent = [label for label in self.labels if label not in there]
            for label in unknown:
                if close := nearest_label(label, absent):
                    raise UserError(
                        f"{where} has a marker '{label}', which layout '{self.name}' lacks; its nearest is '{close}': "
                        f"rename one of them, or add '{label}' to the layout."
                    )
        kept = tuple(marker for marker in self.markers if marker.label in there)
        if len(kept) < _FEWEST:
            raise UserError(
                f"{where} shares {len(kept)} labels with layout '{self.name}', and {_FEWEST} are needed; it has "
                f"{', '.join(there[:8])}{', …' if len(there) > 8 else ''}, the layout {', '.join(self.labels[:8])}, …"
            )
        notes = [f"Layout '{self.name}' has no place for {', '.join(unknown)}: not used."] if unknown else []
        if absent := [label for label in self.labels if label not in there]:
            notes.append(f"{where} has no {', '.join(absent[:12])}{', …' if len(absent) > 12 else ''}.")
        return Layout(self.name, self.n_vertices, kept), notes


@dataclass(frozen=True)
class ObjectLayout:
    """The markers of an object: labels, and (M, 3) positions in the object's own frame, metres."""

    name: str
    labels: tuple[str, ...]
    positions: np.ndarray


def nearest_label(label: str, known: Sequence[str]) -> str | None:
    """Which known label is most like this one, if any is."""
    close = difflib.get_close_matches(label.lower(), [name.lower() for name in known], n=1, cutoff=0.75)
    return next((name for name in known if close and name.lower() == close[0]), None)


def read_layout(path: str | Path, n_vertices: int | None = None, faces: np.ndarray | None = None) -> Layout:
    """Read a body's layout.

    Args:
        path: `.yaml` file: name, vertices (their number in the model), and markers: label → type, and vertex or face
            with weights, and distance where it isn't the usual one.
        n_vertices: of the body model that it is for; any when omitted.
        faces: (F, 3) the model's faces, for markers on faces.

    Raises:
        UserError: no such file, no YAML, or not in this form; for another model; a place that it does not have.
    """
    content = read_mapping(path, "Layout")
    if not isinstance(markers := content.get("markers"), dict) or not markers:
        raise UserError(f"{path} has no markers: label → type and vertex.")
    total = content.get("vertices")
    if not isinstance(total, int):
        raise UserError(f"{path} lacks the number of vertices of the body model that it is for (vertices: …).")
    if n_vertices is not None and total != n_vertices:
        raise UserError(
            f"{path} is for a body model of {total:,} vertices; this one has {n_vertices:,}: give a layout for it "
            "as layout=<file>."
        )
    attached = tuple(_attached(path, str(label), place, total, faces) for label, place in markers.items())
    return Layout(str(content.get("name", Path(path).stem)), total, attached)


def write_layout(path: str | Path, layout: Layout, comments: Mapping[str, str] | None = None) -> None:
    """Write a layout as YAML, one marker a line, each with a comment on where it is."""
    lines = [f"name: {_scalar(layout.name)}", f"vertices: {layout.n_vertices} # of the body model", "markers:"]
    for marker in layout.markers:
        place = f"vertex: {marker.vertices[0]}"
        if len(set(marker.vertices)) > 1:
            weights = ", ".join(map(_number, marker.weights))
            place = f"corners: [{', '.join(map(str, marker.vertices))}], weights: [{weights}]"
        if marker.distance != DISTANCES[marker.type]:
            place += f", distance: {_number(marker.distance)}"
        comment = f" # {comments[marker.label]}" if comments and marker.label in comments else ""
        lines.append(f"  {_scalar(marker.label)}: {{type: {marker.type}, {place}}}{comment}")
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def read_object_layouts(path: str | Path) -> dict[str, ObjectLayout]:
    """Read where markers sit on objects: a YAML file, object → label → position (3) in its own frame, metres.

    Raises:
        UserError: no such file, or not in this form; fewer than 3 markers, or all of them on one line.
    """
    layouts = {}
    for name, markers in read_mapping(path, "Layout of objects").items():
        if not isinstance(markers, dict):
            raise UserError(f"{path}: {name} must be label → [x, y, z].")
        positions = []
        for label, place in markers.items():
            numbers = place if isinstance(place, list) else []
            if len(numbers) != 3 or not all(isinstance(x, int | float) and np.isfinite(x) for x in numbers):
                raise UserError(f"{path}: {label} of {name} must be a position [x, y, z] in metres.")
            positions.append([float(x) for x in numbers])
        layouts[str(name)] = object_layout(str(name), [str(label) for label in markers], np.array(positions))
    return layouts


def object_layout(name: str, labels: Sequence[str], positions: np.ndarray) -> ObjectLayout:
    """Markers of an object, checked.

    Raises:
        UserError: fewer than 3; all on one line: the turn about it would be free.
    """
    if len(positions) < 3:
        raise UserError(f"{name} has {len(positions)} markers; an object needs 3 or more, not on one line.")
    spread = np.linalg.svd(positions - positions.mean(0), compute_uv=False)
    if spread[1] < 1e-3 * spread[0]:
        raise UserError(f"The markers of {name} lie on one line: its turn about that line is not determined.")
    return ObjectLayout(name, tuple(labels), positions)


def spread_markers(name: str, mesh: Mesh, n: int = 8, seed: int = 0) -> ObjectLayout:
    """Place markers on an object, far from each other: every next one farthest from those before. Positions have as
    many digits as in the file of `write_object_layouts`.

    Args:
        name: of the object; labels are m1, m2, ….
        mesh: of the object.
        n: markers.
        seed: of the surface points that are chosen from.
    """
    points = mesh.sample_surface(4000, seed)[0].astype(np.float64)
    chosen = [int(np.linalg.norm(points - points.mean(0), axis=1).argmax())]
    distance = np.full(len(points), np.inf)
    for _ in range(n - 1):
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return object_layout(name, [f"m{k}" for k in range(1, n + 1)], points[chosen].round(_DIGITS))


def write_object_layouts(path: str | Path, layouts: Iterable[ObjectLayout]) -> None:
    """Write where markers sit on objects; `read_object_layouts` reads it."""
    lines = ["# Markers of objects: label → position in the object's own frame, metres."]
    for layout in layouts:
        lines.append(f"{_scalar(layout.name)}:")
        for label, position in zip(layout.labels, layout.positions, strict=True):
            lines.append(f"  {_scalar(label)}: [{', '.join(f'{x:.{_DIGITS}f}' for x in position)}]")
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _number(value: float) -> str:
    """A number without exponent, as YAML takes 1e-07 for text."""
    return np.format_float_positional(value, precision=6, trim="-")


def _scalar(text: str) -> str:
    """A text as YAML has it, in quotes where it needs them."""
    return yaml.safe_dump(text, allow_unicode=True, width=1000).splitlines()[0]


class _StrictSafeLoader(yaml.SafeLoader):
    """Refuses a key that occurs twice, of which YAML keeps the last, and those that YAML reads as true or false."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        names = [str(key) for key in keys]
        for key, (written, _) in zip(keys, node.value, strict=True):
            if isinstance(key, bool) or key is None:
                raise yaml.YAMLError(f"'{written.value}' is not read as a name: put it in quotes")
            if not isinstance(key, str | int | float) or names.count(str(key)) > 1:
                raise yaml.YAMLError(f"'{written.value}' occurs twice, or is no name")
        return super().construct_mapping(node, deep)


def read_mapping(path: str | Path, what: str) -> dict[str, Any]:
    """Read a YAML file that is a mapping; `what` it is, for messages.

    Raises:
        UserError: no such file; no YAML, or no mapping; a key that occurs twice.
    """
    path = existing(path, what)
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), _StrictSafeLoader)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise UserError(f"{path} is no YAML that can be used ({' '.join(str(error).split())[:160]}).") from None
    if not isinstance(content, dict):
        raise UserError(f"{path} is no {what[0].lower() + what[1:]}: it must be a mapping.")
    return {str(key): value for key, value in content.items()}


def _attached(path: object, label: str, place: Any, n_vertices: int, faces: np.ndarray | None) -> Attached:
    place = place if isinstance(place, dict) else {}
    type_ = place.get("type", "body")
    if not isinstance(type_, str) or type_ not in DISTANCES:
        raise UserError(f"{path}: {label} is of type '{type_}'; it can be {', '.join(DISTANCES)}.")
    weights: list[float] = [1.0, 0.0, 0.0]
    if "vertex" in place:
        corners = [place["vertex"]] * 3
    elif "corners" in place or "face" in place:
        corners, weights = place.get("corners"), place.get("weights")
        if (
            corners is None
            and faces is not None
            and isinstance(face := place["face"], int)
            and face in range(len(faces))
        ):
            corners = [int(v) for v in faces[face]]
    else:
        raise UserError(f"{path}: {label} needs a vertex, or a face and its weights.")
    if not (isinstance(corners, list) and len(corners) == 3 and all(isinstance(v, int) for v in corners)) or not all(
        0 <= v < n_vertices for v in corners
    ):
        raise UserError(f"{path}: {label} names a place that is not on a body of {n_vertices:,} vertices.")
    if not (isinstance(weights, list) and len(weights) == 3) or not (
        all(isinstance(w, int | float) and -_ROUNDED <= w <= 1 + _ROUNDED for w in weights)
        and abs(sum(weights) - 1) <= _ROUNDED
    ):
        raise UserError(f"{path}: the weights of {label} must be three numbers from 0 to 1 whose sum is 1.")
    distance = place.get("distance", DISTANCES[type_])
    if not isinstance(distance, int | float) or not 0 <= distance < 0.1:
        raise UserError(f"{path}: the distance of {label} is {distance}; it must be metres, from 0 to 0.1.")
    return Attached(label, type_, tuple(corners), tuple(float(w) for w in weights), float(distance))
