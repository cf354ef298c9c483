"""From a subject's captures to a data set in GRAB's layout: what `grabnet mosh` does.

The folder `out` gets
    grab/<subject>/<capture>.npz        the recordings
    tools/…                             templates of the subject, meshes of the objects and of a table
    mosh/<subject>/<capture>.json       the quality of each; .png plots and .webp films where asked for
    mosh/placement.npz, placement.yaml  where the markers really sit (Stage I)
    mosh/failures.json, run.json        what could not be solved, and how fast the rest was
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from grabnet.body.anatomy import vertex_normals
from grabnet.cli.checks import Amount, Concurrent, Count, Name, Positive, Weight, in_range, one_of
from grabnet.cli.ends import say
from grabnet.cli.progress import steps
from grabnet.data.objects import OBJECT_MESHES, object_files
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh, save_mesh
from grabnet.io.files import existing, replacing, sha256, write_json
from grabnet.io.litter import clear_litter
from grabnet.io.locks import alone_in
from grabnet.io.provenance import provenance
from grabnet.io.recipes import claim
from grabnet.mosh.assembling import NO_OBJECT, TABLE_MESH
from grabnet.mosh.capture_work import CaptureWork, Placement, Reading, expression_directions, read_report, report_path
from grabnet.mosh.captures import expected_frames, find_captures
from grabnet.mosh.choosing import choose_frames
from grabnet.mosh.layouts import Layout, read_layout, read_object_layouts, write_layout
from grabnet.mosh.placing import marker_positions
from grabnet.mosh.priors import PriorConfig
from grabnet.mosh.quality import Limits
from grabnet.mosh.stage_one import StageOneConfig, stage_one
from grabnet.mosh.stage_two import StageTwoConfig
from grabnet.mosh.subjects import Subject
from grabnet.mosh.tallies import followed
from grabnet.preprocess.backends import Outcome, by_dask, by_joblib, machine_cores
from grabnet.visual.pictures import can_render

# Raise it when the same capture and settings would give another recording.
FORMAT = 1
_TRUNK_JOINTS = (0, 3, 6, 9)
_TABLE_SIZE = (1.2, 0.8, 0.03)  # metres


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
    if config.objects is not None:
        read_object_layouts(config.objects)
    with alone_in(config.root, "out"):
        remedy = f"delete {config.root / 'mosh'}, or choose another out="
        claim(config.root / "mosh/recipe.json", _recipe(config), remedy)
        clear_litter(config.root, "grab/*/*.*", "mosh/*.*", "mosh/*/*.*", "tools/*/*.*", "tools/*/*/*.*")
        placement = _placement(config, subject, layout, files)
        subject.write(config.root, placement.v_template)
        _write_things(config)
        work = CaptureWork(
            captures, config.root, placement, subject, config.reading, config.objects, config.meshes, config.prior,
            config.stage_two, config.limits, config.max_gap, config.tolerance, config.object_smooth, config.pictures,
            config.threads,
        )  # fmt: skip
        outcomes = list(_work(config, work))
        failures = sorted((o for o in outcomes if o.failure), key=lambda o: o.name)
        write_json(config.root / "mosh/failures.json", {o.name: o.failure for o in failures})
        if config.pictures and (reason := can_render()):
            print(reason)
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
        print("No scan of the subject: the model's mean shape stands for theirs. Give subject= or fit=unscanned.")


def _recipe(config: MoshConfig) -> dict[str, Any]:
    """All that decides a recording besides its capture."""
    files = {key: getattr(config, key) for key in ("layout", "subject", "objects")}
    settings = {key: asdict(getattr(config, key)) for key in ("reading", "stage_one", "stage_two", "prior", "limits")}
    return {
        "format": FORMAT,
        "name": config.name,
        "gender": config.gender,
        "max_gap": config.max_gap,
        "tolerance": config.tolerance,
        "object_smooth": config.object_smooth,
        **{f"{key}_sha256": None if path is None else sha256(existing(path, key)) for key, path in files.items()},
        **settings,
    }


def _placement(config: MoshConfig, subject: Subject, layout: Layout, files: list[Path]) -> Placement:
    """Where the markers sit: found from some captures, or as found before."""
    npz, yaml = config.root / "mosh/placement.npz", config.root / "mosh/placement.yaml"
    if npz.exists() and yaml.exists():
        return Placement.load(npz, read_layout(yaml))
    chosen = files[:: max(1, len(files) // config.stage_one_captures)][: config.stage_one_captures]
    own = []
    for path in chosen:
        markers = config.reading.read(path)
        try:
            own.append(config.reading.of_subject(markers, layout))
        except UserError as error:
            raise UserError(f"{path}: {error}.") from None
    there = {label for markers in own for label in markers.labels}
    where = chosen[0] if len(chosen) == 1 else config.capture
    layout, notes = layout.restricted(sorted(there), where)
    for note in notes:
        print(note)
    positions = np.concatenate([markers.pick(layout.labels).positions for markers in own])
    body, template = subject.body, subject.v_template
    normals = vertex_normals(template.double(), body.faces).numpy()
    resting = marker_positions(layout, template.double().numpy(), normals)
    corner = [marker.vertices[0] for marker in layout.markers]
    trunk = body.weights[corner][:, _TRUNK_JOINTS].sum(1).numpy() > 0.6
    frames = choose_frames(positions, resting, trunk, config.stage_one.frames, config.capture)
    seen = np.isfinite(positions[frames][..., 0])
    if not (shown := seen.any(0)).all():
        lost = [label for label, there in zip(layout.labels, shown, strict=True) if not there]
        print(f"{', '.join(lost)}: in none of Stage I's frames, so where the layout has it.")
    directions = None if config.stage_one.betas else expression_directions(body)
    found = stage_one(body, template, layout, positions[frames], config.stage_one, config.prior, directions)
    typical = float(found.residuals.nanmedian())
    print(f"Stage I: {len(frames)} frames; markers {1e3 * typical:.2f} mm (median) from where the body has them.")
    write_layout(yaml, found.layout)
    with replacing(npz) as temporary:
        np.savez(temporary, latent=found.latent.numpy(), v_template=found.v_template.numpy(),
                 betas=found.betas.numpy(), labels=np.array(layout.labels))  # fmt: skip
    return Placement(found.layout, found.latent, found.v_template)


def _write_things(config: MoshConfig) -> None:
    """Write the meshes that recordings name: the objects', a table's, and that of no object."""
    meshes = {} if config.meshes is None else object_files(config.meshes)
    if config.objects is not None:
        names = read_object_layouts(config.objects)
        for name, path in meshes.items():
            if name in names:
                save_mesh(_made(config.root / OBJECT_MESHES / f"{name}.ply"), load_mesh(path, weld=False))
    speck = trimesh.creation.box((1e-3,) * 3)
    save_mesh(_made(config.root / OBJECT_MESHES / f"{NO_OBJECT}.ply"), Mesh(speck.vertices, speck.faces))
    top = trimesh.creation.box(_TABLE_SIZE)
    top.apply_translation((0, 0, -_TABLE_SIZE[2] / 2))
    save_mesh(_made(config.root / TABLE_MESH), Mesh(top.vertices, top.faces))


def _made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


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
        config.root / "mosh/run.json",
        provenance(
            captures=len(outcomes), frames=frames, seconds=round(seconds, 3), solving_cpu_seconds=round(cpu, 3),
            peak_mb_of_workers={o.worker: round(o.peak_bytes / 1e6) for o in outcomes if o.worker},
            config=asdict(config),
        ),
    )  # fmt: skip
    for name, report in reports.items():
        for note in report["notes"]:
            print(f"{name}: {note}")
        print(f"{name}: {_in_short(report)}")
    if frames and cpu:
        print(f"Solved {frames} frames at {frames / cpu:.0f} frames per second of one core.")
    print(f"The recordings are in {config.root / 'grab'}.")


def _in_short(report: dict[str, Any]) -> str:
    """How good a recording is; what was not seen, or not believed, stands beside the distances."""
    body, thing = report["body"], report["object"]
    line = f"{body['frames']} frames, markers {body['residual_mm']['median']} mm off (median)"
    line += f", {body['missing']:.1%} missing, {body['outliers']:.1%} outliers"
    line += f", {body['flagged_frames']} frames flagged" * bool(body["flagged_frames"])
    return line + (f", {thing['name']} {thing['residual_mm']} mm" if thing else "")
