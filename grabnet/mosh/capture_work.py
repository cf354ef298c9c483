"""From one capture to its recording: what a worker does."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from grabnet.data.sequences import write_sequence
from grabnet.errors import UserError
from grabnet.io.files import sha256, write_json
from grabnet.io.state import Finite, read_json
from grabnet.mosh.assembling import assemble
from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.choosing import refuse_other_size
from grabnet.mosh.layouts import ObjectLayout
from grabnet.mosh.objects import Followed, Following, follow_one, mesh_of
from grabnet.mosh.placement import Placement
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.quality import Limits, marker_residuals, quality
from grabnet.mosh.reading import Reading
from grabnet.mosh.stage_one import on_trunk
from grabnet.mosh.stage_two import StageTwoConfig, put_right, stage_two
from grabnet.mosh.subjects import Subject, expression_directions
from grabnet.mosh.tallies import Tally
from grabnet.preprocess.backends import Outcome
from grabnet.preprocess.sequence_work import outcome_of

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
class CaptureWork:
    """Solves captures by name, in any process.

    Attributes:
        captures: file of each name.
        root: of the data set that is written.
        placement: of the markers.
        subject: whose they are.
        reading: of the files.
        layouts: of the objects that may be followed.
        following: how.
        prior, config, limits: settings.
        pictures: whether to draw the quality.
        threads: of torch.
        dtype: float32, or float64 at twice the time.
    """

    captures: dict[str, Path]
    root: Path
    placement: Placement
    subject: Subject
    reading: Reading
    layouts: dict[str, ObjectLayout]
    following: Following
    prior: PriorConfig
    config: StageTwoConfig
    limits: Limits
    pictures: bool
    threads: int
    dtype: str = "float32"

    def __call__(self, name: str) -> Outcome:
        """Never raises for what is wrong with the one capture.

        Raises:
            OSError: the folder cannot be written to.
        """
        torch.set_num_threads(self.threads)
        return outcome_of(name, self.root, lambda: self._solve(name))

    def _solve(self, name: str) -> None:
        path, began = self.captures[name], time.monotonic()
        markers = self.reading.read(path)
        layout, body = self.placement.layout, self.subject.body
        own = self.reading.of_subject(path, markers, layout)
        _, notes = layout.restricted(own.labels, path)
        observed = own.pick(layout.labels).positions
        directions, dtype = expression_directions(body), getattr(torch, self.dtype)
        attachment = Attachment(
            body, self.placement.v_template, layout, self.placement.latent, directions, dtype, self.prior.fixed
        )
        trunk = on_trunk(attachment)
        refuse_other_size(observed, self.placement.latent.numpy(), trunk.numpy(), path)
        tally, solving = Tally(self.root, name), time.process_time()
        try:
            pose = stage_two(
                attachment, torch.as_tensor(observed), markers.rate, joint_prior(body, self.prior), self.prior,
                self.config, trunk, lambda share: tally.add(share * len(markers)),
            )  # fmt: skip
            notes += _exchanged(attachment, pose, torch.as_tensor(observed), self.config.relabel)
            solving = time.process_time() - solving
            followed = follow_one(markers, self.layouts, self.following) if self.layouts else Followed()
        except UserError as error:
            raise UserError(f"{path}: {error}.") from None
        mesh = None if followed.motion is None else mesh_of(self.root, self.layouts[followed.name])
        sequence = assemble(
            name, self.subject, self.placement.v_template, pose, markers.rate, followed.name, followed.motion, mesh
        )
        residuals, model = marker_residuals(attachment, pose, observed)
        report = {
            "capture": str(path),
            "sha256": sha256(path),
            "notes": [*markers.notes, *notes, *followed.notes],
            "body": quality(residuals, model, observed, markers.rate, layout, self.limits),
            "object": followed.quality(),
            "seconds": round(time.monotonic() - began, 3),
            "solving_cpu_seconds": round(solving, 3),
        }
        write_sequence(self.root / "grab" / f"{name}.npz", sequence)
        if self.pictures:
            from grabnet.mosh.drawing import Solved, draw_quality

            solved = Solved(sequence, body, self.placement.v_template, layout, observed, model, residuals)
            draw_quality(self.root / "mosh" / name, solved, report["body"], self.limits, mesh)
        write_json(report_path(self.root, name), report)  # last: what has a report is done


def _exchanged(attachment: Attachment, pose: Pose, observed: Tensor, reach: float) -> list[str]:
    """How many markers count under other labels than the capture's, if any do."""
    labelled = put_right(attachment, pose, observed, reach)
    moved = ~labelled.isclose(observed, rtol=0, atol=0, equal_nan=True).all(-1) & labelled[..., 0].isfinite()
    if not moved.any():
        return []
    return [
        f"{int(moved.sum())} marker positions in {int(moved.any(1).sum())} frames fit another label than the "
        "capture's, and count under it (stage_two.relabel); residuals are by the capture's labels."
    ]


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
