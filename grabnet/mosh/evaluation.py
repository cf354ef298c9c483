"""How far solved bodies are from the truth, on synthetic captures of recordings (paper S.8, table S.1)."""

from __future__ import annotations

import itertools
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
from torch import Tensor

from grabnet.body.anatomy import vertex_normals
from grabnet.body.skeleton import JOINTS
from grabnet.body.whole import BodyModel, BodyParameters
from grabnet.cli.checks import Count, Filled, Name, Several, in_range
from grabnet.cli.progress import steps
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import Sequence, load_below, read_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.io.files import existing, write_json
from grabnet.io.names import originals
from grabnet.io.provenance import provenance
from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.choosing import choose_frames
from grabnet.mosh.doubting import undoubted
from grabnet.mosh.layouts import Layout, ObjectLayout, read_layout, spread_markers
from grabnet.mosh.placing import marker_positions
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.rigid import follow
from grabnet.mosh.stage_one import StageOneConfig, on_trunk, stage_one
from grabnet.mosh.stage_two import StageTwoConfig, stage_two
from grabnet.mosh.synthesis import Flaws, clean_markers, in_one_ring, object_markers, spoilt, with_moving_face

# Published: mean, its standard deviation, median; millimetres (paper S.8).
PUBLISHED = {"vanilla": ((4.76, 1.03, 4.55), (5.59, 1.86, 5.28)), "ours": ((3.09, 0.55, 2.80), (4.86, 1.83, 4.48))}
_JAW = JOINTS.index("jaw")  # the first joint beyond the limbs
_HANDS = 25  # the first joint of a hand
_BATCH = 64
_METRICS = "metrics.json"  # what a search reads: grabnet/sweeps/runs.py
_OF_FRAMES = ("places", "vertices", "hands", "face", "body", "object_shift", "object_turn")
OBJECT_SMOOTH = 10  # frames to either side over which an object's pose is averaged: mosh.yaml's


@dataclass(frozen=True)
class Version:
    """A way to solve: its settings."""

    stage_one: StageOneConfig
    stage_two: StageTwoConfig
    prior: PriorConfig


@dataclass(frozen=True)
class EvaluationConfig:
    """What to measure; the values of `configs/mosh/evaluate.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    root: str
    layout: str
    subjects: Annotated[list[Name], Filled()]
    sequences: Count
    frames: Several
    seeds: Count
    versions: Annotated[dict[str, Version], Filled()]
    conditions: Annotated[dict[str, Flaws], Filled()]
    solve: Annotated[list[Name], Filled()]
    under: Annotated[list[Name], Filled()]
    objective: str
    sweep_dir: str
    output: str
    quiet: bool = False

    def __post_init__(self):
        in_range(self)
        for key, known in (("solve", self.versions), ("under", self.conditions), ("objective", (*_OF_FRAMES, "jump"))):
            given = [self.objective] if key == "objective" else getattr(self, key)
            if unknown := [name for name in given if name not in known]:
                raise UserError(f"{key} is {unknown[0]}; it can be {', '.join(known)}.")


@dataclass(frozen=True)
class Measured:
    """One recording solved once; millimetres and degrees.

    Attributes:
        places: (M,) distance of each marker's place to where it sits, of Stage I.
        vertices: (T,) mean distance of vertices, of Stage II; hands, face and trunk with limbs of those parts alone.
        jump: largest motion of a vertex from frame to frame that the truth does not have.
        object_shift, object_turn: (T,) error of the object's pose.
        frames_per_second: of Stage II, by the time of one core.
    """

    places: np.ndarray
    vertices: np.ndarray
    hands: np.ndarray
    face: np.ndarray
    body: np.ndarray
    jump: float
    object_shift: np.ndarray
    object_turn: np.ndarray
    frames_per_second: float


@dataclass(frozen=True)
class Recorded:
    """A recording to capture: its sequence, its subject's v_template (V, 3) and the markers of its object."""

    sequence: Sequence
    v_template: Tensor
    object_layout: ObjectLayout


def run(config: EvaluationConfig) -> int:
    """Measure every version under every condition, and print the table; returns the exit code 0.

    Raises:
        UserError: no such recordings.
    """
    torch.set_num_threads(1)
    table: dict[str, Any] = {}
    for (version, condition), measured in measure_all(config).items():
        table[f"{version}, {condition}"] = summary(measured)
    for line in lines(table, config):
        print(line)
    write_json(Path(config.output) / "mosh.json", provenance(config=asdict(config), published=PUBLISHED, table=table))
    write_json(Path(config.output) / _METRICS, metrics(table))
    print(f"Written to {Path(config.output) / 'mosh.json'}.")
    return 0


def measure_all(config: EvaluationConfig) -> dict[tuple[str, str], list[Measured]]:
    """By version and condition: a measurement for each recording and seed."""
    body = BodyModel.open()
    layout = read_layout(config.layout, len(body.v_template), body.faces.numpy())
    found: dict[tuple[str, str], list[Measured]] = {}
    paths, ways = _recordings(config), list(itertools.product(config.solve, config.under))
    with steps("Solving synthetic captures", len(paths) * config.seeds * len(ways)) as counted:
        for path, seed in itertools.product(paths, range(config.seeds)):
            capture = Capture(_read(Path(config.root), path), body, layout, seed)
            for name, condition in ways:
                measured = capture.measure(config.versions[name], config.conditions[condition], config.frames)
                found.setdefault((name, condition), []).append(measured)
                counted.advance(about=f"{path.parent.name}/{path.stem}: {measured.vertices.mean():.2f} mm, {name}")
    return found


class Capture:
    """A recording with markers on it, wherever a seed puts them."""

    def __init__(self, recorded: Recorded, body: BodyModel, layout: Layout, seed: int):
        self.body, self.layout, self.seed, self.recorded = body, layout, seed, recorded
        self.sequence = with_moving_face(recorded.sequence, seed)
        self.v_template = recorded.v_template
        truth = in_one_ring(layout, body.faces.numpy(), seed)
        rest, normals = self.v_template.double().numpy(), vertex_normals(self.v_template.double(), body.faces).numpy()
        self.latent, self.guess = (torch.as_tensor(marker_positions(one, rest, normals)) for one in (truth, layout))
        self.markers = clean_markers(self.sequence, body, self.v_template, truth)
        self.object_markers = object_markers(self.sequence, recorded.object_layout)

    def measure(self, version: Version, flaws: Flaws, frames: int) -> Measured:
        """Solve it and compare with the truth, from the middle of the recording."""
        both = np.concatenate([self.markers, self.object_markers], 1)
        both = spoilt(both, self.sequence.framerate, flaws, self.seed)
        seen, of_object = np.split(both, [self.markers.shape[1]], 1)
        fixed = version.prior.fixed
        trunk = on_trunk(Attachment(self.body, self.v_template, self.layout, self.guess))
        clear = undoubted(torch.as_tensor(seen), version.stage_one.doubt).numpy()
        chosen = choose_frames(
            clear, self.guess.numpy(), trunk.numpy(), version.stage_one.frames, self.sequence.name
        )  # fmt: skip
        one = stage_one(self.body, self.v_template, self.layout, clear[chosen], version.stage_one, version.prior)
        attachment = Attachment(self.body, self.v_template, one.layout, one.latent, fixed=fixed)
        first = max(0, (len(seen) - frames) // 2)
        now = slice(first, first + frames)
        began = time.process_time()
        pose = stage_two(
            attachment, torch.as_tensor(seen[now]), self.sequence.framerate, joint_prior(self.body, version.prior),
            version.prior, version.stage_two, trunk,
        )  # fmt: skip
        seconds = time.process_time() - began
        errors, jump = self._vertex_errors(pose, now)
        owner = self.body.weights.argmax(1)
        parts = {"hands": owner >= _HANDS, "face": owner == _JAW, "body": owner < _JAW}
        shift, turn = self._object_errors(of_object[now], now)
        return Measured(
            places=1e3 * (one.latent - self.latent).norm(dim=-1).numpy(),
            vertices=errors.mean(1).numpy(),
            **{name: errors[:, those].mean(1).numpy() for name, those in parts.items()},
            jump=jump,
            object_shift=shift,
            object_turn=turn,
            frames_per_second=len(errors) / seconds,
        )

    @torch.no_grad()
    def _vertex_errors(self, pose: Pose, now: slice) -> tuple[Tensor, float]:
        """(T, V) distances of vertices, and the largest jump; millimetres."""
        truth = self.sequence.body.parameters(now)
        errors, jump, last = [], 0.0, None
        for start in range(0, len(pose.transl), _BATCH):
            few = slice(start, start + _BATCH)
            found, true = (
                self.body(BodyParameters.from_rotations(r[few].float(), t[few].float()), self.v_template).vertices
                for r, t in ((pose.rotations, pose.transl), (truth.rotations, truth.transl))
            )
            off = found - true
            errors.append(1e3 * off.norm(dim=-1))
            both = off if last is None else torch.cat([last, off])
            if len(both) > 1:
                jump = max(jump, 1e3 * float(both.diff(dim=0).norm(dim=-1).max()))
            last = off[-1:]
        return torch.cat(errors), jump

    def _object_errors(self, seen: np.ndarray, now: slice) -> tuple[np.ndarray, np.ndarray]:
        motion = follow(
            torch.as_tensor(self.recorded.object_layout.positions), torch.as_tensor(seen), smooth=OBJECT_SMOOTH
        )
        track = self.sequence.object
        shift = 1e3 * np.linalg.norm(motion.transl.numpy() - track.transl[now], axis=1)
        between = motion.rotations.mT @ track.rotations(now).double()
        cosine = (between.diagonal(dim1=1, dim2=2).sum(-1) - 1) / 2
        return shift, torch.rad2deg(torch.arccos(cosine.clamp(-1, 1))).numpy()


def summary(measured: list[Measured]) -> dict[str, Any]:
    """Mean, standard deviation over frames (Stage I: over markers) and median of what was measured."""
    facts: dict[str, Any] = {}
    for name in _OF_FRAMES:
        values = np.concatenate([getattr(one, name) for one in measured])
        facts[name] = [round(float(x), 3) for x in (values.mean(), values.std(), np.median(values))]
    facts["jump"] = round(max(one.jump for one in measured), 2)
    facts["frames_per_second"] = round(float(np.median([one.frames_per_second for one in measured])), 1)
    return facts


def metrics(table: dict[str, Any]) -> dict[str, float]:
    """Means of the table's lines, by what was measured."""
    found = {name: [facts[name][0] for facts in table.values()] for name in _OF_FRAMES}
    found["jump"] = [facts["jump"] for facts in table.values()]
    return {name: round(float(np.mean(values)), 4) for name, values in found.items()}


def lines(table: dict[str, Any], config: EvaluationConfig) -> list[str]:
    """The table as text, the published figures beside ours."""
    head = f"{'':<22}{'Stage I':>22}{'Stage II':>22}{'hands':>8}{'face':>7}{'body':>7}{'jump':>7}"
    head += f"{'object':>16}{'frames/s':>10}"
    made = [
        f"{config.seeds} seeds, subjects {', '.join(config.subjects)}; mm: mean ± std, median; object: mm, degrees",
        head,
    ]
    for name, (one, two) in PUBLISHED.items():
        made.append(f"{name + ' (published)':<22}{_spread(one):>22}{_spread(two):>22}")
    for name, facts in table.items():
        made.append(
            f"{name:<22}{_spread(facts['places']):>22}{_spread(facts['vertices']):>22}{facts['hands'][0]:>8.2f}"
            f"{facts['face'][0]:>7.2f}{facts['body'][0]:>7.2f}{facts['jump']:>7.1f}"
            f"{facts['object_shift'][0]:>8.2f} {facts['object_turn'][0]:>6.2f}°{facts['frames_per_second']:>10.0f}"
        )
    return made


def _spread(values: tuple[float, ...] | list[float]) -> str:
    mean, deviation, median = values
    return f"{mean:.2f} ± {deviation:.2f}, {median:.2f}"


def _recordings(config: EvaluationConfig) -> list[Path]:
    root = existing(config.root, "Folder of recordings (root)")
    found = []
    for subject in config.subjects:
        folder = root / "grab" / subject
        paths = originals((path for path in folder.glob("*.npz") if path.is_file()), folder)[: config.sequences]
        if not paths:
            raise UserError(f"{folder} holds no recordings: make some with grabnet build sequences.")
        found += paths
    return found


def _read(root: Path, path: Path) -> Recorded:
    sequence = read_sequence(path)
    mesh = load_mesh(existing(root / OBJECT_MESHES / f"{sequence.obj_name}.ply", "Mesh of the object"), weld=False)
    v_template = torch.tensor(load_below(root, sequence.body.vtemp).vertices)
    return Recorded(sequence, v_template, spread_markers(sequence.obj_name, mesh))
