"""Labelled markers of a capture, as everything after the reading of files sees them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from grabnet.errors import UserError

# Metres per unit, by the beginning of its name: capture software cuts names off, as in "mete".
_UNITS = {"mm": 1e-3, "milli": 1e-3, "cm": 1e-2, "centi": 1e-2, "dm": 1e-1, "deci": 1e-1, "m": 1.0, "inch": 0.0254}
# What lies between the outermost markers of a frame, metres: of a hand at least, of a large volume at most.
_PLAUSIBLE = (0.03, 30.0)
# With no unit named, one that puts a body's markers this far apart is taken for meant, metres.
_A_BODY = (0.3, 20.0)
# Kinds of modelled outputs that share a file's list of points with markers.
_NO_MARKER = re.compile(r"(angles?|forces?|moments?|powers?|scalars?)$", re.IGNORECASE)
_UNLABELLED = re.compile(r"^(\*|U|unlabell?ed[ _]?|ghost_?)?\d+$", re.IGNORECASE)


@dataclass(frozen=True)
class MarkerData:
    """Markers of one capture, or of one subject or object in it.

    Attributes:
        labels: one per marker, unique.
        positions: (T, M, 3) float64, metres, world frame; NaN where a marker is missing.
        rate: frames per second.
        notes: what was left out or taken for something on reading, in sentences.
    """

    labels: tuple[str, ...]
    positions: np.ndarray
    rate: float
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.positions)

    @property
    def seen(self) -> np.ndarray:
        """(T, M) whether a marker is there."""
        return np.isfinite(self.positions[..., 0])

    @property
    def prefixes(self) -> tuple[str, ...]:
        """What stands before the colon of labels, in order of appearance; "" for labels without one."""
        return tuple(dict.fromkeys(_prefix(label) for label in self.labels))

    def under(self, prefix: str) -> MarkerData:
        """The markers of one prefix, their labels without it.

        Raises:
            UserError: no label has it.
        """
        if prefix not in self.prefixes:
            known = ", ".join(p or "(none)" for p in self.prefixes)
            raise UserError(f"No marker has the prefix '{prefix}'; the labels' prefixes are {known}.")
        kept = [i for i, label in enumerate(self.labels) if _prefix(label) == prefix]
        labels = tuple(self.labels[i].rpartition(":")[2] for i in kept)
        return replace(self, labels=labels, positions=self.positions[:, kept])

    def pick(self, labels: Sequence[str]) -> MarkerData:
        """Markers of these labels, in this order; those that the capture lacks are missing in every frame."""
        positions = np.full((len(self), len(labels), 3), np.nan)
        for i, label in enumerate(labels):
            if label in self.labels:
                positions[:, i] = self.positions[:, self.labels.index(label)]
        return replace(self, labels=tuple(labels), positions=positions)

    def frames(self, chosen: np.ndarray | slice) -> MarkerData:
        """Chosen frames."""
        return replace(self, positions=self.positions[chosen])


def scale_of(unit: str) -> float | None:
    """Metres per unit; None for one that is no length."""
    name = unit.strip().strip("\x00").lower()
    if name and ("meters".startswith(name) or "metres".startswith(name)):
        return 1.0
    return next((scale for start, scale in _UNITS.items() if start != "m" and name.startswith(start)), None)


def markers_of(
    path: object,
    labels: Sequence[str],
    positions: np.ndarray,
    rate: float,
    unit: str | Sequence[str],
    given_unit: str | None = None,
    not_markers: Iterable[str] = (),
    up: str = "z",
) -> MarkerData:
    """Markers out of what a file holds, checked: the one way from any file to `MarkerData`.

    Args:
        path: of the file, for messages.
        labels: as stored; as many as points, or fewer.
        positions: (T, P, 3) in the file's unit; a point that is NaN in one coordinate or exactly 0 in all is missing.
        rate: frames per second.
        unit: the file's, or one per point; empty where it names none.
        given_unit: replaces the file's.
        not_markers: labels that the file declares to be angles, forces and the like.
        up: the file's vertical axis, x, y or z; positions are turned so that z is up.

    Raises:
        UserError: no points or no frames; every marker missing; a rate or unit that cannot be; markers too close
            together or too far apart to be in that unit.
    """
    if not positions.shape[1]:
        raise UserError(f"{path} holds no markers: it has analog data only. Export the trajectories, too.")
    if not len(positions):
        raise UserError(f"{path} holds 0 frames.")
    if not (np.isfinite(rate) and rate > 0):
        raise UserError(f"{path} says that it has {rate} frames per second: export it with its frame rate.")
    notes: list[str] = []
    names = _named(labels, positions.shape[1], notes)
    units = [unit] * len(names) if isinstance(unit, str) else [*unit][: len(names)]
    units += units[-1:] * (len(names) - len(units)) or [""] * len(names)
    declared = {str(label) for label in not_markers}
    kept = [i for i, name in enumerate(names) if not (name in declared or _NO_MARKER.search(name))]
    if left := [name for i, name in enumerate(names) if i not in set(kept)]:
        notes.append(f"{len(left)} points that are no markers (angles, forces and the like) are left out.")
    if loose := [i for i in kept if _UNLABELLED.match(names[i].rpartition(":")[2])]:
        notes.append(f"{len(loose)} unlabelled points are left out.")
        kept = [i for i in kept if i not in set(loose)]
    if not kept:
        raise UserError(f"{path} holds {len(names)} points, none of them a labelled marker: label the markers first.")
    places = np.array(positions[:, kept], np.float64)
    places[~np.isfinite(places).all(-1) | (places == 0).all(-1)] = np.nan
    if not np.isfinite(places).any():
        raise UserError(f"{path}: its {len(kept)} markers are missing in all {len(places)} frames.")
    spread = _spread(places)
    scales = _scales(path, [given_unit or units[i] for i in kept], spread, notes)
    places *= scales[:, None]
    spread *= float(np.median(scales))
    if not _PLAUSIBLE[0] <= spread <= _PLAUSIBLE[1]:
        raise UserError(
            f"{path}: its markers lie {spread:.3g} m apart when read in '{given_unit or units[kept[0]]}', which no "
            "capture does: give the right reading.unit=mm, cm or m."
        )
    return MarkerData(tuple(names[i] for i in kept), _upright(places, up), float(rate), tuple(notes))


def _named(labels: Sequence[str], n_points: int, notes: list[str]) -> list[str]:
    """A unique name for every point: numbers for those without a label, "(2)" after a second of the same name."""
    names = [str(label).strip().strip("\x00") for label in labels][:n_points]
    names += [""] * (n_points - len(names))
    seen: dict[str, int] = {}
    for i, name in enumerate(names):
        if not name:
            names[i] = f"*{i}"
            continue
        seen[name] = seen.get(name, 0) + 1
        if seen[name] > 1:
            names[i] = f"{name} ({seen[name]})"
    if twice := [name for name, count in seen.items() if count > 1]:
        notes.append(f"The label {', '.join(twice)} occurs more than once: the first of each counts.")
    return names


def _scales(path: object, units: Sequence[str], spread: float, notes: list[str]) -> np.ndarray:
    scales = []
    for unit in units:
        if unit.strip("\x00 "):
            if (scale := scale_of(unit)) is None:
                raise UserError(
                    f"{path} is in the unit '{unit}', which is no length: give the right reading.unit=mm, cm or m."
                )
        else:
            fitting = [(name, s) for name, s in (("m", 1.0), ("mm", 1e-3)) if _A_BODY[0] <= spread * s <= _A_BODY[1]]
            if len(fitting) != 1:
                raise UserError(
                    f"{path} names no unit, and its markers lie {spread:.3g} apart: give reading.unit=mm, cm or m."
                )
            name, scale = fitting[0]
            note = f"The file names no unit: its markers lie {spread:.3g} apart, so it is taken to be in {name}."
            notes.extend([] if note in notes else [note])
        scales.append(scale)
    return np.array(scales)


def _spread(places: np.ndarray) -> float:
    """Typical distance between the outermost markers of a frame."""
    some = places[np.isfinite(places[..., 0]).sum(1) > 1][:: max(1, len(places) // 50)]
    if not len(some):
        return float(np.linalg.norm(np.nanmax(places, (0, 1)) - np.nanmin(places, (0, 1))))
    return float(np.median(np.linalg.norm(np.nanmax(some, 1) - np.nanmin(some, 1), axis=-1)))


def _upright(places: np.ndarray, up: str) -> np.ndarray:
    """Turned so that the axis `up` becomes z; a rotation, so left stays left."""
    order = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}
    if up not in order:
        raise UserError(f"up is '{up}'; it can be x, y, z.")
    return places[..., order[up]]


def _prefix(label: str) -> str:
    return label.rpartition(":")[0]
