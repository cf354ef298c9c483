"""From a subject's captures to a data set in GRAB's layout: what `grabnet mosh` does.

The folder `out` gets
    grab/<subject>/<capture>.npz        the recordings
    tools/…                             templates of the subject, meshes of the objects and of a table
    mosh/<subject>/<capture>.json       the quality of each; .png plots and .webp films where asked for
    mosh/<subject>.placement.npz, .yaml where the markers really sit (Stage I)
    mosh/<subject>.failures.json        what could not be solved; .run.json: how fast the rest was
    mosh/<subject>.recipe.json          the settings: several subjects, each by a run of its own, share a folder
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from grabnet.cli.checks import Amount, Concurrent, Count, Name, Positive, Weight, in_range, one_of
from grabnet.cli.ends import note, say
from grabnet.cli.progress import steps
from grabnet.errors import UserError
from grabnet.io.files import existing, sha256, write_json
from grabnet.io.litter import clear_litter
from grabnet.io.locks import alone_in
from grabnet.io.provenance import provenance
from grabnet.io.recipes import claim
from grabnet.mosh.capture_work import CaptureWork, read_report, report_path
from grabnet.mosh.captures import expected_frames, find_captures
from grabnet.mosh.layouts import Layout, read_layout, read_object_layouts
from grabnet.mosh.objects import Following, check_objects, write_meshes
from grabnet.mosh.placement import Placement, find_placement
from grabnet.mosh.priors import PriorConfig
from grabnet.mosh.quality import Limits
from grabnet.mosh.reading import Reading
from grabnet.mosh.stage_one import StageOneConfig
from grabnet.mosh.stage_two import StageTwoConfig
from grabnet.mosh.subjects import Subject
from grabnet.mosh.tallies import followed
from grabnet.preprocess.backends import Outcome, by_dask, by_joblib, machine_cores
from grabnet.visual.pictures import can_render

# Raise it when the same capture and settings would give another recording.
FORMAT = 2


@dataclass(frozen=True)
class MoshConfig:
    """What to solve; the values of `configs/mosh/mosh.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    capture: str
    layout: str
    subject: str | None
    out: str
    name: Name
    gender: str
    models: str | None
    objects: str | None
    meshes: str | None
    reading: Reading
    stage_one: StageOneConfig
    stage_one_captures: Count
    stage_two: StageTwoConfig
    prior: PriorConfig
    limits: Limits
    max_gap: Amount
    tolerance: Positive
    object_smooth: Weight
    pictures: bool
    backend: str
    workers: Concurrent
    dask_address: str | None
    max_deaths: Count
    threads: Concurrent = 1
    quiet: bool = False

    def __post_init__(self):
        one_of(self, backend=("joblib", "dask"), gender=("male", "female", "neutral"))
        in_range(self)
        if (self.backend == "dask") != (self.dask_address is not None):
            raise UserError("backend=dask and dask_address=tcp://… belong together: give both or neither.")
        if any(c in self.name for c in "/\\") or self.name.startswith("."):
            raise UserError(f"name is '{self.name}'; it must be usable as a folder's name.")

    @property
    def root(self) -> Path:
        return Path(self.out).resolve()

    def record(self, what: str) -> Path:
        """File of the subject's own beside the reports."""
        return self.root / "mosh" / f"{self.name}.{what}"


def run(config: MoshConfig) -> int:
    """Solve the captures and say where the recordings are.

    Returns:
        the exit code: 0 all are solved, 1 some failed.

    Raises:
        UserError: nothing to solve; models, templates, layouts that don't fit; a folder of another recipe.
    """
    began, subject = time.monotonic(), Subject(config.name, config.gender, config.subject, config.models)
    body = subject.body
    subject.v_template  # noqa: B018, refused before anything is written
    _check_shape(config, body.n_betas)
    layout = read_layout(config.layout, len(body.v_template), body.faces.numpy())
    files = find_captures(config.capture)
    captures = {f"{config.name}/{path.stem}": path for path in files}
    if len(captures) < len(files):
        raise UserError(f"{config.capture} holds captures of the same name: the recordings are named after them.")
    layouts = {} if config.objects is None else read_object_layouts(config.objects)
    meshes = check_objects(config.meshes, layouts)
    with alone_in(config.root, "out"):
        recipe, placed = config.record("recipe.json"), config.record("placement.npz")
        if not placed.exists():  # nothing was solved by it
            recipe.unlink(missing_ok=True)
        remedy = f"delete {config.root / 'mosh' / config.name} and {config.record('*')}, or choose another out="
        claim(recipe, _recipe(config, subject, meshes), remedy)
        clear_litter(config.root, "grab/*/*.*", "mosh/*.*", "mosh/*/*.*", "tools/*/*.*", "tools/*/*/*.*")
        placement = _placement(config, subject, layout, files)
        subject.write(config.root, placement.v_template)
        write_meshes(config.root, meshes)
        work = CaptureWork(
            captures, config.root, placement, subject, config.reading, layouts,
            Following(config.tolerance, config.max_gap, config.object_smooth), config.prior, config.stage_two,
            config.limits, config.pictures, config.threads,
        )  # fmt: skip
        outcomes = list(_work(config, work))
        failures = sorted((o for o in outcomes if o.failure), key=lambda o: o.name)
        write_json(config.record("failures.json"), {o.name: o.failure for o in failures})
        if config.pictures and (reason := can_render()):
            note(reason)
        reports = {name: read_report(config.root, name) for name in captures
                   if report_path(config.root, name).exists()}  # fmt: skip
        _summarise(config, reports, outcomes, time.monotonic() - began)
    for failure in failures:
        say(f"{failure.name}: {failure.failure}")
    return 1 if failures else 0


def _check_shape(config: MoshConfig, n_betas: int) -> None:
    """Say or refuse what would silently give another body than the subject's."""
    betas = config.stage_one.betas
    if betas > n_betas:
        raise UserError(f"stage_one.betas is {betas}; the body model has {n_betas} betas.")
    if betas and config.subject is not None:
        raise UserError(f"{config.subject} gives the subject's shape: stage_one.betas must be 0, not {betas}.")
    if not betas and config.subject is None:
        note("No scan of the subject: the model's mean shape stands for theirs. Give subject= or fit=unscanned.")


def _recipe(config: MoshConfig, subject: Subject, meshes: dict[str, Path]) -> dict[str, Any]:
    """All that decides a recording besides its capture."""
    files = {"layout": config.layout, "objects": config.objects} | subject.files()
    files |= {f"mesh of {name}": path for name, path in meshes.items()}
    settings = {key: asdict(getattr(config, key)) for key in ("reading", "stage_one", "stage_two", "prior", "limits")}
    return {
        "format": FORMAT,
        "name": config.name,
        "gender": config.gender,
        "stage_one_captures": config.stage_one_captures,
        "max_gap": config.max_gap,
        "tolerance": config.tolerance,
        "object_smooth": config.object_smooth,
        **{f"{key}_sha256": None if path is None else sha256(existing(path, key)) for key, path in files.items()},
        **settings,
    }


def _placement(config: MoshConfig, subject: Subject, layout: Layout, files: list[Path]) -> Placement:
    """Where the markers sit: found from some captures, or as found before."""
    path = config.record("placement")
    if Path(f"{path}.npz").exists():
        note(f"The markers sit where {path}.yaml has them, as found before.")
        return Placement.load(path)
    found = find_placement(
        subject, layout, files, config.reading, config.stage_one_captures, config.stage_one, config.prior
    )
    found.save(path)
    return Placement.load(path)  # a run that goes on has the same numbers


def _work(config: MoshConfig, work: CaptureWork) -> Iterator[Outcome]:
    """Outcomes of what is not done; shows frames per second and the time left meanwhile."""
    left = [name for name in work.captures if not _is_done(config.root, name, work.captures[name])]
    outcomes = (
        by_dask(work, left, config.dask_address)
        if config.backend == "dask"
        else by_joblib(work, left, min(config.workers, machine_cores(), max(1, len(left))), config.max_deaths)
    )
    frames = {name: expected_frames(path) for name, path in work.captures.items()}
    done = sum(n for name, n in frames.items() if name not in left)
    worked_on = {name: frames[name] for name in left}
    with (
        steps("Solving frames", sum(frames.values()), done) as counted,
        followed(config.root, worked_on, counted) as ended,
    ):
        for outcome in outcomes if left else ():
            ended(outcome.name)
            yield outcome


def _is_done(root: Path, name: str, capture: Path) -> bool:
    report = report_path(root, name)
    if not (report.exists() and (root / "grab" / f"{name}.npz").exists()):
        return False
    return read_report(root, name)["sha256"] == sha256(capture)


def _summarise(config: MoshConfig, reports: dict[str, Any], outcomes: list[Outcome], seconds: float) -> None:
    new = [reports[o.name] for o in outcomes if not o.failure]
    frames = sum(report["body"]["frames"] for report in new)
    cpu = sum(report["solving_cpu_seconds"] for report in new)
    write_json(
        config.record("run.json"),
        provenance(
            captures=len(outcomes), frames=frames, seconds=round(seconds, 3), solving_cpu_seconds=round(cpu, 3),
            peak_mb_of_workers={o.worker: round(o.peak_bytes / 1e6) for o in outcomes if o.worker},
            config=asdict(config),
        ),
    )  # fmt: skip
    for name, report in reports.items():
        for remark in report["notes"]:
            note(f"{name}: {remark}")
        note(f"{name}: {_in_short(report)}")
    if frames and cpu:
        note(f"Solved {frames} frames at {frames / cpu:.0f} frames per second of one core.")
    note(f"The recordings are in {config.root / 'grab'}.")


def _in_short(report: dict[str, Any]) -> str:
    """How good a recording is; what was not seen, or not believed, stands beside the distances."""
    body, followed_object = report["body"], report["object"]
    line = f"{body['frames']} frames, markers {body['residual_mm']['median']} mm off (median)"
    line += f", {body['missing']:.1%} missing, {body['outliers']:.1%} outliers"
    line += f", {body['flagged_frames']} frames flagged" * bool(body["flagged_frames"])
    return line + (f", {followed_object['name']} {followed_object['residual_mm']} mm" if followed_object else "")
