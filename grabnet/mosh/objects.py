"""Objects of captures: which one a capture follows, where it is, and the meshes that recordings name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

from grabnet.data.objects import OBJECT_MESHES, object_files
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh, read_mesh, save_mesh
from grabnet.mosh.assembling import NO_OBJECT, TABLE_MESH
from grabnet.mosh.layouts import ObjectLayout
from grabnet.mosh.markers import MarkerData
from grabnet.mosh.placing import balls
from grabnet.mosh.rigid import DegenerateMarkersError, RigidMotion, follow

_TABLE_SIZE = (1.2, 0.8, 0.03)  # metres
_BALL = 0.005  # metres, radius of what stands for a marker where an object has no mesh


@dataclass(frozen=True)
class Following:
    """How objects are followed.

    Attributes:
        tolerance: metres beyond which a marker is an outlier.
        max_gap: frames of a gap that is interpolated.
        smooth: seconds to either side over which a pose is averaged.
    """

    tolerance: float
    max_gap: int
    smooth: float


@dataclass(frozen=True)
class Followed:
    """An object in a capture. name: `NO_OBJECT` for none. motion: of it. labels: used. notes: for people."""

    name: str = NO_OBJECT
    motion: RigidMotion | None = None
    labels: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def quality(self) -> dict[str, Any] | None:
        """Facts for the report, JSON-able; lengths in millimetres."""
        if self.motion is None:
            return None
        millimetres = 1e3 * self.motion.residuals
        return {
            "name": self.name,
            "residual_mm": round(float(millimetres.nanmean()), 3),
            "residual_mm_by_marker": {
                label: _rounded(millimetres[:, k].nanmean()) for k, label in enumerate(self.labels)
            },
            "missing": round(float(millimetres.isnan().double().mean()), 4),
            "solved": int(self.motion.solved.sum()),
            "interpolated": int(self.motion.filled.sum()),
            "unknown_frames": (~self.motion.solved & ~self.motion.filled).nonzero().squeeze(1).tolist(),
        }


def follow_one(markers: MarkerData, layouts: Mapping[str, ObjectLayout], how: Following) -> Followed:
    """Follow the object of a capture: of those with a layout the one that moves most.

    Raises:
        UserError: fewer than three of its markers are there, or no frame shows three.
    """
    present = [p for p in markers.prefixes if p in layouts]
    if not present:
        known = ", ".join(p or "(none)" for p in markers.prefixes)
        return Followed(notes=(f"No object of the layout is among the prefixes {known}: none is followed.",))
    moving = max(present, key=lambda p: _travel(markers.under(p)))
    notes = [f"Several objects are there, {', '.join(present)}: the one that moves most, {moving}, is followed."]
    notes = notes[: len(present) > 1]
    own, layout = markers.under(moving), layouts[moving]
    kept = [k for k, label in enumerate(layout.labels) if label in own.labels]
    labels = tuple(layout.labels[k] for k in kept)
    unused = [label for label in own.labels if label not in layout.labels]
    if len(kept) < 3:
        raise UserError(
            f"{moving} has {len(kept)} markers of its layout, and 3 are needed; the capture has "
            f"{', '.join(own.labels)}, the layout {', '.join(layout.labels)}"
        )
    if unused:
        notes.append(f"The layout of {moving} has no place for {', '.join(unused)}: not used.")
    if lacking := [label for label in layout.labels if label not in own.labels]:
        notes.append(f"{moving} has no {', '.join(lacking)}.")
    try:
        positions, observed = torch.as_tensor(layout.positions[kept]), torch.as_tensor(own.pick(labels).positions)
        smooth = round(how.smooth * markers.rate)
        motion = follow(positions, observed, how.tolerance, how.max_gap, smooth=smooth)
    except DegenerateMarkersError as error:
        raise UserError(f"{moving} cannot be followed: {error}") from None
    if unknown := int((~motion.solved & ~motion.filled).sum()):
        notes.append(f"Where {moving} is, is not known in {unknown} frames: its last known pose stands there.")
    return Followed(moving, motion, labels, tuple(notes))


def check_objects(meshes: str | None, layouts: Mapping[str, ObjectLayout]) -> dict[str, Path]:
    """Mesh files of those objects that have one.

    Raises:
        UserError: no such folder; no object has a layout; none of the meshes is of an object that has one; a name that
            is no file's.
    """
    for name in layouts:
        if "/" in name or "\\" in name or name.startswith(".") or name == NO_OBJECT:
            raise UserError(f"An object is named '{name}'; its mesh could not be named so: rename it.")
    if meshes is None:
        return {}
    if not layouts:
        raise UserError("meshes= is given without objects=, which says where the markers sit on them.")
    found = {name: path for name, path in object_files(meshes).items() if name in layouts}
    if not found:
        raise UserError(f"{meshes} holds a mesh of none of the objects that have a layout: {', '.join(layouts)}.")
    return found


def mesh_of(root: Path, layout: ObjectLayout) -> Mesh:
    """The mesh that recordings of an object name; where nobody gave one, balls at its markers, which are written."""
    path = root / OBJECT_MESHES / f"{layout.name}.ply"
    if not path.exists():
        n = len(layout.positions)
        shape = balls(layout.positions, np.full(n, _BALL), np.ones((n, 3)))
        save_mesh(_made(path), Mesh(shape.vertices, shape.faces))
    return read_mesh(path, weld=False, mend=False)


def write_meshes(root: Path, meshes: Mapping[str, Path]) -> None:
    """Write what recordings name: the objects' meshes, that of no object, and a table's."""
    for name, path in meshes.items():
        save_mesh(_made(root / OBJECT_MESHES / f"{name}.ply"), load_mesh(path, weld=False))
    speck = trimesh.creation.box((1e-3,) * 3)
    save_mesh(_made(root / OBJECT_MESHES / f"{NO_OBJECT}.ply"), Mesh(speck.vertices, speck.faces))
    top = trimesh.creation.box(_TABLE_SIZE)
    top.apply_translation((0, 0, -_TABLE_SIZE[2] / 2))
    save_mesh(_made(root / TABLE_MESH), Mesh(top.vertices, top.faces))


def _made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _travel(markers: MarkerData) -> float:
    """How far half of an object's markers move at least, metres; below 0 where none is ever seen."""
    own = markers.positions[:, markers.seen.any(0)]
    return float(np.median((np.nanmax(own, 0) - np.nanmin(own, 0)).max(1))) if own.shape[1] else -1.0


def _rounded(millimetres: torch.Tensor) -> float | None:
    """None for a marker that is never seen."""
    return round(float(millimetres), 3) if millimetres.isfinite() else None
