"""From one capture to its recording: what a worker does."""

from __future__ import annotations

import os
import socket
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from grabnet.cli.checks import Positive, in_range
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import write_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import read_mesh
from grabnet.io.files import DISK_ERRORS, sha256, write_json
from grabnet.io.npz import read_npz
from grabnet.io.state import Finite, read_json
from grabnet.mosh.assembling import NO_OBJECT, assemble
from grabnet.mosh.attachment import Attachment
from grabnet.mosh.captures import read_capture
from grabnet.mosh.layouts import Layout, ObjectLayout, read_object_layouts
from grabnet.mosh.markers import MarkerData
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.quality import Limits, marker_residuals, quality
from grabnet.mosh.rigid import DegenerateMarkersError, RigidMotion, follow
from grabnet.mosh.stage_one import on_trunk
from grabnet.mosh.stage_two import StageTwoConfig, stage_two
from grabnet.mosh.subjects import Subject
from grabnet.mosh.tallies import Tally
from grabnet.preprocess.backends import Outcome
from grabnet.preprocess.sequence_work import peak_memory

# What is read back of a report.
_REPORT = {
    "sha256": str,
    "notes": [str],
    "body": {
        "frames": Finite(0),
        "residual_mm": {"median": (None, float), "*": object},
        "missing": float,
        "outliers": float,
        "flagged_frames": Finite(0),
        "flagged": {str: [int]},
        "*": object,
    },
    "object": (None, {"name": str, "residual_mm": float, "*": object}),
    "solving_cpu_seconds": Finite(0),
}


@dataclass(frozen=True)
class Reading:
    """How captures are read: see `read_capture`. prefix: of the subject's labels; the one that fits best when None.

    Raises:
        UserError: a rate out of range.
    """

    unit: str | None = None
    up: str = "z"
    rate: Positive | None = None
    prefix: str | None = None

    def __post_init__(self):
        in_range(self, "reading.")

    def read(self, path: Path) -> MarkerData:
        """All markers of a file."""
        return read_capture(path, self.unit, self.up, self.rate)

    def of_subject(self, markers: MarkerData, layout: Layout) -> MarkerData:
        """The subject's markers among all."""
        if self.prefix is not None:
            return markers.under(self.prefix)
        shared = {p: len({*markers.under(p).labels} & {*layout.labels}) for p in markers.prefixes}
        best = max(shared, key=shared.get)
        if rivals := [p for p in shared if p != best and shared[p] > 0.5 * shared[best]]:
            fitting = ", ".join([best, *rivals])
            raise UserError(f"the labels of {fitting} all fit the layout: say whom to solve by reading.prefix=")
        return markers.under(best)


@dataclass(frozen=True)
class Placement:
    """Where a subject's markers sit, as Stage I found it. layout, latent (M, 3), v_template (V, 3): as `StageOne`."""

    layout: Layout
    latent: Tensor
    v_template: Tensor

    @classmethod
    def load(cls, path: Path, layout: Layout) -> Placement:
        """Read what `save` wrote."""
        stored = read_npz(path)
        return cls(layout, torch.as_tensor(stored["latent"]), torch.as_tensor(stored["v_template"]))


@dataclass(frozen=True)
class CaptureWork:
    """Solves captures by name, in any process.

    Attributes:
        captures: file of each name.
        root: of the data set that is written.
        placement: of the markers.
        subject: whose they are.
        reading: of the files.
        objects: file of the objects' layouts; None to follow none.
        meshes: folder of the objects' meshes.
        prior, config, limits: settings.
        max_gap: frames of an object's gap that is interpolated.
        tolerance: metres beyond which an object's marker is an outlier.
        smooth: seconds to either side over which an object's pose is averaged.
        pictures: whether to draw the quality.
        threads: of torch.
        dtype: float32, or float64 at twice the time.
    """

    captures: dict[str, Path]
    root: Path
    placement: Placement
    subject: Subject
    reading: Reading
    objects: str | None
    meshes: str | None
    prior: PriorConfig
    config: StageTwoConfig
    limits: Limits
    max_gap: int
    tolerance: float
    smooth: float
    pictures: bool
    threads: int
    dtype: str = "float32"

    def __call__(self, name: str) -> Outcome:
        """Never raises for what is wrong with the one capture.

        Raises:
            UserError: the disk takes no more.
        """
        torch.set_num_threads(self.threads)
        failure = None
        try:
            self._solve(name)
        except UserError as error:
            failure = str(error)
        except Exception as error:
            if isinstance(error, OSError) and error.errno in DISK_ERRORS:
                raise UserError(f"{self.root} cannot be written to ({error.strerror}): make room there.") from None
            at = [frame for frame in traceback.extract_tb(error.__traceback__) if "grabnet" in frame.filename][-1]
            failure = f"{type(error).__name__}: {error} ({Path(at.filename).name}, line {at.lineno})"
        return Outcome(name, failure, f"{socket.gethostname()}:{os.getpid()}", peak_memory())

    def _solve(self, name: str) -> None:
        path, began = self.captures[name], time.monotonic()
        markers = self.reading.read(path)
        layout, latent = self.placement.layout, self.placement.latent
        try:
            own = self.reading.of_subject(markers, layout)
            _, notes = layout.restricted(own.labels, path)
            observed = own.pick(layout.labels).positions
            body = self.subject.body
            attachment = Attachment(
                body,
                self.placement.v_template,
                layout,
                latent,
                expression_directions(body),
                getattr(torch, self.dtype),
            )
            trunk = on_trunk(attachment)
            prior = joint_prior(body, self.prior)
            solving = time.process_time()
            tally = Tally(self.root, name)
            pose = stage_two(
                attachment, torch.as_tensor(observed), markers.rate, prior, self.prior, self.config, trunk,
                lambda share: tally.add(share * len(markers)),
            )  # fmt: skip
            solving = time.process_time() - solving
            object_name, motion, object_labels, more = self._object(markers)
        except UserError as error:
            raise UserError(str(error) if str(path) in str(error) else f"{path}: {error}.") from None
        notes += more
        mesh = None
        if motion is not None and (file := self.root / OBJECT_MESHES / f"{object_name}.ply").exists():
            mesh = read_mesh(file, weld=False, mend=False)
        sequence = assemble(
            name, self.subject, self.placement.v_template, pose, markers.rate, object_name, motion, mesh
        )
        residuals, model = marker_residuals(attachment, pose, observed)
        report = {
            "capture": str(path),
            "sha256": sha256(path),
            "notes": [*markers.notes, *notes],
            "body": quality(residuals, model, observed, markers.rate, layout, self.limits),
            "object": _object_quality(object_name, motion, object_labels),
            "seconds": round(time.monotonic() - began, 3),
            "solving_cpu_seconds": round(solving, 3),
        }
        write_sequence(self.root / "grab" / f"{name}.npz", sequence)
        if self.pictures:
            from grabnet.mosh.drawing import Solved, draw_quality

            solved = Solved(sequence, body, self.placement.v_template, layout, observed, model, residuals)
            draw_quality(self.root / "mosh" / name, solved, report["body"], self.limits, mesh)
        write_json(report_path(self.root, name), report)  # last: what has a report is done

    def _object(self, markers: MarkerData) -> tuple[str, RigidMotion | None, tuple[str, ...], list[str]]:
        """The object that a capture follows: of those with a layout the one whose markers are seen most."""
        if self.objects is None:
            return NO_OBJECT, None, (), []
        layouts = read_object_layouts(self.objects)
        present = [p for p in markers.prefixes if p in layouts]
        if not present:
            known = ", ".join(p or "(none)" for p in markers.prefixes)
            return NO_OBJECT, None, (), [f"No object of the layout is among the prefixes {known}: none is followed."]
        moving = max(present, key=lambda p: _travel(markers.under(p)))
        notes = [f"Several objects are there, {', '.join(present)}: the one that moves most, {moving}, is followed."]
        motion, kept = follow_object(
            markers.under(moving), layouts[moving], self.tolerance, self.max_gap, round(self.smooth * markers.rate)
        )
        unknown = int((~motion.solved & ~motion.filled).sum())
        notes = notes[: len(present) > 1]
        if unknown:
            notes.append(f"Where {moving} is, is not known in {unknown} frames: its last known pose stands there.")
        return moving, motion, kept, notes


def follow_object(
    markers: MarkerData, layout: ObjectLayout, tolerance: float, max_gap: int, smooth: int
) -> tuple[RigidMotion, tuple[str, ...]]:
    """Follow an object of a layout; also the labels that were used.

    Raises:
        UserError: fewer than three of its markers are there, or no frame shows three.
    """
    kept = [k for k, label in enumerate(layout.labels) if label in markers.labels]
    labels = tuple(layout.labels[k] for k in kept)
    if len(kept) < 3:
        raise UserError(f"{layout.name} has {len(kept)} markers of its layout, and 3 are needed")
    try:
        positions, observed = torch.as_tensor(layout.positions[kept]), torch.as_tensor(markers.pick(labels).positions)
        return follow(positions, observed, tolerance, max_gap, smooth=smooth), labels
    except DegenerateMarkersError as error:
        raise UserError(f"{layout.name} cannot be followed: {error}") from None


def expression_directions(body) -> Tensor | None:
    """(V, 3, up to 10) the directions of expression that move anything; None of a model that has none."""
    directions = body.shapedirs[..., body.n_betas : body.n_betas + 10]
    used = directions.abs().amax((0, 1)) > 0
    return directions[..., used] if used.any() else None


def report_path(root: Path, name: str) -> Path:
    """Where the quality of a recording is written."""
    return root / "mosh" / f"{name}.json"


def read_report(root: Path, name: str) -> dict[str, Any]:
    """The quality of a recording, as it was written.

    Raises:
        UserError: no such file, or a damaged one.
    """
    path = report_path(root, name)
    return read_json(path, _REPORT, "delete it, and the capture is solved again")


def _travel(markers: MarkerData) -> float:
    middle = np.nanmean(np.where(markers.seen[..., None], markers.positions, np.nan), 1)
    middle = middle[np.isfinite(middle[:, 0])]
    return float(np.ptp(middle, axis=0).max()) if len(middle) else -1.0


def _object_quality(name: str, motion: RigidMotion | None, labels: tuple[str, ...]) -> dict | None:
    if motion is None:
        return None
    millimetres = 1e3 * motion.residuals
    return {
        "name": name,
        "residual_mm": round(float(millimetres.nanmean()), 3),
        "residual_mm_by_marker": {
            label: round(float(millimetres[:, k].nanmean()), 3) for k, label in enumerate(labels)
        },
        "solved": int(motion.solved.sum()),
        "interpolated": int(motion.filled.sum()),
        "unknown_frames": (~motion.solved & ~motion.filled).nonzero().squeeze(1).tolist(),
    }  # fmt: skip
