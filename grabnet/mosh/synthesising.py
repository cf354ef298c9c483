"""Synthetic captures of recordings, on disk: what `grabnet mosh synthesise` does.

The folder `out` gets
    captures/<subject>/<capture>.c3d    the markers of body and object, labelled <subject>:… and <object>:…
    objects.yaml                        where the objects' markers sit
    grab/…, tools/…                     the recordings that were captured: the truth
    truth/<subject>/<capture>.npz       where the markers sit on the body, and were, free of noise; see
                                        `capture_making.write_truth`
    truth/<subject>/<capture>.json      how many markers are missing, and why
    recipe.json, run.json               settings, seeds and versions; how fast it was
"""

from __future__ import annotations

import contextlib
import shlex
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from grabnet.cli.checks import Concurrent, Name, Seed, in_range
from grabnet.cli.ends import say
from grabnet.cli.progress import steps
from grabnet.data.objects import OBJECT_MESHES
from grabnet.errors import UserError
from grabnet.geometry.mesh import load_mesh
from grabnet.io.files import existing, sha256, write_json
from grabnet.io.litter import clear_litter
from grabnet.io.locks import alone_in
from grabnet.io.names import originals
from grabnet.io.provenance import provenance
from grabnet.io.recipes import claim
from grabnet.io.shipped import shipped
from grabnet.io.state import Finite, read_json
from grabnet.mosh.cameras import Rig
from grabnet.mosh.capture_making import CaptureMaking, capture_path
from grabnet.mosh.layouts import read_layout, spread_markers, write_object_layouts
from grabnet.mosh.subjects import GENDERS, Subject
from grabnet.mosh.synthesis import Flaws
from grabnet.preprocess.backends import by_joblib, machine_cores

# Raise it when the same recording and settings would give another capture.
FORMAT = 1
_LAYOUT = shipped("configs") / "mosh/layouts/open_body_grab99.yaml"  # that captures are solved with by default
_FACTS = {
    "recording_sha256": str,
    "object": str,
    "frames": Finite(1),
    "missing": Finite(0),
    "hidden": Finite(0),
    "cpu_seconds": Finite(0),
    "*": object,
}


@dataclass(frozen=True)
class SynthesisConfig:
    """What to capture; the values of `configs/mosh/synthesise.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    root: str
    recordings: list[Name] | None
    out: str
    layout: str
    models: str | None
    face: bool
    flaws: Flaws
    occlusion: bool
    rig: Rig
    seed: Seed
    workers: Concurrent
    quiet: bool = False

    def __post_init__(self):
        in_range(self)
        if Path(self.out).resolve() == Path(self.root).resolve():
            raise UserError(f"out is root, {self.root}, whose recordings would be replaced: choose another out=")


def run(config: SynthesisConfig) -> int:
    """Make the captures, and say how they can be solved.

    Returns:
        the exit code: 0 all are made, 1 some failed.

    Raises:
        UserError: no such recordings; a layout for another body; a folder of another recipe.
    """
    root, out, began = existing(config.root, "Folder of recordings (root)"), Path(config.out), time.monotonic()
    names = _names(root, config.recordings)
    subject = Subject("", "neutral" if config.models is None else "male", None, config.models)
    layout = read_layout(config.layout, len(subject.body.v_template), subject.body.faces.numpy())
    rig = config.rig if config.occlusion else None
    with alone_in(out, "out"):
        claim(out / "recipe.json", _recipe(config), f"delete {out}, or choose another out=")
        clear_litter(out, "*/*/*.*", "tools/*/*/*.*")
        work = CaptureMaking(root, out, layout, config.models, config.face, config.flaws, rig, config.seed)
        left = [name for name in names if not _is_made(root, out, name)]
        outcomes = []
        with steps("Making captures", len(names), len(names) - len(left)) as counted:
            workers = min(config.workers, machine_cores(), max(1, len(left)))
            for outcome in by_joblib(work, left, workers, max_deaths=3) if left else ():
                outcomes.append(outcome)
                counted.advance(about=outcome.name)
        failed = {outcome.name: outcome.failure for outcome in outcomes if outcome.failure}
        made = {name: _facts(out, name) for name in names if name not in failed}
        _write_objects(out)
        _summarise(config, made, time.monotonic() - began)
    for name, failure in sorted(failed.items()):
        say(f"{name}: {failure}")
    return 1 if failed else 0


def _names(root: Path, chosen: list[str] | None) -> list[str]:
    """Recordings below a root, all or those chosen by name."""
    folder = existing(root / "grab", "Folder of recordings")
    there = [f"{path.parent.name}/{path.stem}" for path in originals(folder.glob("*/*.npz"), folder)]
    if not there:
        raise UserError(f"{folder} holds no recordings: make some with grabnet build sequences.")
    if unknown := [name for name in chosen or () if name not in there]:
        raise UserError(f"{root} has no recording '{unknown[0]}'; it has {', '.join(there[:5])}, …")
    return there if chosen is None else list(dict.fromkeys(chosen))


def _recipe(config: SynthesisConfig) -> dict[str, Any]:
    """All that decides a capture besides its recording."""
    return {
        "format": FORMAT,
        "layout_sha256": sha256(existing(config.layout, "Layout")),
        "body_sha256": _bodies(config.models),
        "seed": config.seed,
        "face": config.face,
        "flaws": asdict(config.flaws),
        "rig": asdict(config.rig) if config.occlusion else {},
    }


def _bodies(models: str | None) -> dict[str, str]:
    """Hashes of the body models that recordings can have, by gender."""
    found = {}
    for gender in GENDERS if models is not None else ("neutral",):
        with contextlib.suppress(UserError):  # no model of that gender: its recordings fail
            found[gender] = sha256(Subject("", gender, None, models).files()["body"])
    return found


def _is_made(root: Path, out: Path, name: str) -> bool:
    """Whether there is a capture of the recording as it is now."""
    if not capture_path(out, name).exists():
        return False
    return _facts(out, name)["recording_sha256"] == sha256(root / "grab" / f"{name}.npz")


def _facts(out: Path, name: str) -> dict[str, Any]:
    return read_json(out / "truth" / f"{name}.json", _FACTS, "delete it and its capture, which is made again then")


def _write_objects(out: Path) -> None:
    """Write the markers of all objects captured, in this run or an earlier one."""
    truth = out / "truth"
    facts = (_facts(out, f"{path.parent.name}/{path.stem}") for path in originals(truth.glob("*/*.json"), truth))
    names = {one["object"] for one in facts}
    meshes = {name: load_mesh(out / OBJECT_MESHES / f"{name}.ply", weld=False, mend=False) for name in sorted(names)}
    write_object_layouts(out / "objects.yaml", [spread_markers(name, mesh) for name, mesh in meshes.items()])


def _summarise(config: SynthesisConfig, made: dict[str, dict[str, Any]], seconds: float) -> None:
    out = Path(config.out)
    frames, cpu = (sum(fact[key] for fact in made.values()) for key in ("frames", "cpu_seconds"))
    write_json(out / "run.json", provenance(captures=made, seconds=round(seconds, 3), config=asdict(config)))
    for name, fact in made.items():
        shares = f"{100 * fact['missing']:.1f} % of the markers missing, {100 * fact['hidden']:.1f} % hidden"
        print(f"{name}: {fact['frames']} frames, {shares} from the cameras")
    if not made:
        return
    print(f"Made {frames:,} frames at {frames / cpu:.0f} frames per second of one core. To solve them:")
    for person in dict.fromkeys(name.partition("/")[0] for name in made):
        template = next((out / "tools/subject_meshes").glob(f"*/{person}.ply"), None)
        values = {"capture": out / "captures" / person, "name": person}
        if template is not None:
            values |= {"gender": template.parent.name, "subject": template}
        if Path(config.layout) != _LAYOUT:
            values["layout"] = config.layout
        if config.models is not None:
            values["models"] = config.models
        values |= {"objects": out / "objects.yaml", "meshes": out / OBJECT_MESHES, "out": "solved"}
        print("  grabnet mosh", shlex.join(f"{key}={value}" for key, value in values.items()))
