"""How far solved recordings are from those that were captured: what `grabnet mosh judge` does."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from grabnet.body.anatomy import vertex_normals
from grabnet.body.whole import BodyModel
from grabnet.cli.checks import Count, in_range
from grabnet.cli.ends import note, say
from grabnet.cli.progress import track
from grabnet.contact.agreement import agreeing, shares
from grabnet.data.sequences import Sequence, load_below, read_sequence
from grabnet.errors import UserError
from grabnet.geometry.rotations import matrix_to_axis_angle
from grabnet.io.files import existing, write_json
from grabnet.io.names import originals
from grabnet.io.npz import read_npz
from grabnet.io.provenance import provenance
from grabnet.mosh.subjects import Subject
from grabnet.mosh.synthesis import posed_vertices

_FIRST_HAND_JOINT = 25
# Of a recording's errors, what is printed.
_COLUMNS = {
    "places": "markers' places mm", "vertices": "vertices mm", "hands": "hands mm", "object": "object mm",
    "turn": "object °", "part_agreement": "parts agree", "part_f1": "parts F1", "vertex_f1": "vertices F1",
}  # fmt: skip


@dataclass(frozen=True)
class JudgeConfig:
    """What to compare; the values of `configs/mosh/judge.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    truth: str
    solved: str
    contact: str | None
    models: str | None
    every: Count
    output: str
    quiet: bool = False

    def __post_init__(self):
        in_range(self)


def run(config: JudgeConfig) -> int:
    """Compare the recordings of the truth with those solved, and print it.

    Returns:
        the exit code: 0 all are compared, 1 some could not be or are not solved.

    Raises:
        UserError: no such folders, or no recording in common.
    """
    truth, solved = (
        existing(config.truth, "Folder of the truth"),
        existing(config.solved, "Folder of solved recordings"),
    )
    names, there = _names(truth), set(_names(solved))
    common, lacking = [name for name in names if name in there], [name for name in names if name not in there]
    if not common:
        raise UserError(f"{truth} and {solved} have no recording of the same name in their folders grab.")
    errors, contact, failures = {}, Counter(), {}
    for name in track(common, "Comparing recordings"):
        try:
            errors[name] = _errors(config, truth, solved, name)
            if config.contact is not None:
                counts = _contact(config, truth, name)
                contact.update(counts)
                errors[name] |= shares(counts)
        except UserError as error:
            failures[name] = str(error)
    whole = {key: _mean([one[key] for one in errors.values() if key in one]) for key in _COLUMNS}
    whole |= shares(contact) if contact else {}
    _print(errors | ({"all": whole} if errors else {}))
    write_json(
        config.output,
        provenance(
            config=asdict(config), recordings=errors, all=whole, contact=contact, failed=failures, not_solved=lacking
        ),
    )
    print(f"Written to {config.output}.")
    if without := [name for name, one in errors.items() if "object" not in one]:
        note(f"In {len(without)} of {len(errors)} the object is not followed: {', '.join(without)}.")
    if lacking:
        say(f"{len(lacking)} of {len(names)} are not solved: {', '.join(lacking)}.")
    for name, failure in failures.items():
        say(f"{name}: {failure}")
    return 1 if failures or lacking else 0


def _names(root: Path) -> list[str]:
    """Recordings below a root."""
    folder = root / "grab"
    there = originals(folder.glob("*/*.npz"), folder) if folder.exists() else []
    return [f"{path.parent.name}/{path.stem}" for path in there]


def _errors(config: JudgeConfig, truth: Path, solved: Path, name: str) -> dict[str, float]:
    """Mean distances in millimetres of vertices, those of the hands, and the object; its turn in degrees; mean
    distance of markers' places, where the truth has them."""
    one, other = (read_sequence(root / "grab" / f"{name}.npz") for root in (truth, solved))
    if len(one) != len(other):
        raise UserError(f"{name} has {len(one)} frames in {truth} and {len(other)} in {solved}.")
    if config.models is not None and one.gender != other.gender:
        raise UserError(
            f"{name} is {one.gender} in {truth} and {other.gender} in {solved}, whose models differ: solve it with "
            f"gender={one.gender}."
        )
    frames = np.arange(0, len(one), config.every)
    body = Subject("", one.gender, None, config.models).body
    templates = [_template(root, sequence, body) for root, sequence in ((truth, one), (solved, other))]
    posed = [posed_vertices(s.body, body, t, frames) for s, t in zip((one, other), templates, strict=True)]
    distance = 1e3 * torch.cat([(a - b).norm(dim=-1) for a, b in zip(*posed, strict=True)])
    hands = body.weights.argmax(1) >= _FIRST_HAND_JOINT
    errors = {"vertices": distance.mean().item(), "hands": distance[:, hands].mean().item()}
    if one.obj_name == other.obj_name:
        errors |= _object_errors(one, other, frames)
    places = truth / "truth" / f"{name}.npz", solved / "mosh" / f"{Path(name).parent}.placement.npz"
    if all(path.exists() for path in places):
        errors["places"] = _place_error(*places, body, templates[0])
    return errors


def _template(root: Path, sequence: Sequence, body: BodyModel) -> torch.Tensor:
    """(V, 3) the resting body of a recording."""
    vertices = torch.tensor(load_below(root, sequence.body.vtemp, mend=False).vertices)
    if len(vertices) != len(body.v_template):
        raise UserError(
            f"{root / sequence.body.vtemp} has {len(vertices):,} vertices, the body model {len(body.v_template):,}: "
            "give the folder of its model as models=."
        )
    return vertices


def _object_errors(one: Sequence, other: Sequence, frames: np.ndarray) -> dict[str, float]:
    shift = np.linalg.norm(one.object.transl[frames] - other.object.transl[frames], axis=1)
    between = one.object.rotations(frames).mT.double() @ other.object.rotations(frames).double()
    turn = matrix_to_axis_angle(between).norm(dim=-1)
    return {"object": 1e3 * float(shift.mean()), "turn": float(turn.mean().rad2deg())}


def _place_error(truth: Path, found: Path, body: BodyModel, v_template: torch.Tensor) -> float:
    """Mean distance in millimetres of the markers' places on the body at rest."""
    true = _stored(truth, ("corners", "weights", "distance", "labels"), "make the captures again")
    there = _stored(found, ("labels", "latent"), "solve the captures again")
    rest, normals = v_template.double(), vertex_normals(v_template.double(), body.faces)
    corners, weights = torch.as_tensor(true["corners"]), torch.as_tensor(true["weights"]).unsqueeze(-1)
    outward = torch.nn.functional.normalize((normals[corners] * weights).sum(1), dim=-1)
    places = (rest[corners] * weights).sum(1) + torch.as_tensor(true["distance"]).unsqueeze(1) * outward
    labels = [str(label).rpartition(":")[2] for label in true["labels"][: len(corners)]]
    if others := [str(label) for label in there["labels"] if str(label) not in labels]:
        raise UserError(f"{found} places {', '.join(others[:5])}, which {truth} lacks: they are of two layouts.")
    own = [labels.index(str(label)) for label in there["labels"]]
    return 1e3 * float((places[own] - torch.as_tensor(there["latent"])).norm(dim=-1).mean())


def _stored(path: Path, names: tuple[str, ...], remedy: str) -> dict[str, Any]:
    stored = read_npz(path)
    if lacking := [name for name in names if name not in stored]:
        raise UserError(f"{path} has no {', '.join(lacking)}, as of an older version: {remedy}.")
    return stored


def _contact(config: JudgeConfig, truth: Path, name: str) -> Counter[str]:
    found = read_sequence(existing(Path(config.contact) / "grab" / f"{name}.npz", "Contact found"))
    stored = read_sequence(truth / "grab" / f"{name}.npz")
    labels = [sequence.contact.object[:: config.every] for sequence in (stored, found)]
    if labels[0].shape != labels[1].shape:
        raise UserError(
            f"{name}: its labels are {labels[0].shape} in {truth} and {labels[1].shape} in {config.contact}."
        )
    return agreeing(*labels)


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _print(rows: dict[str, dict[str, Any]]) -> None:
    shown = [key for key in _COLUMNS if any(row.get(key) is not None for row in rows.values())]
    width = max(map(len, rows), default=0)
    print("  ".join([" " * width, *(_COLUMNS[key] for key in shown)]))
    for name, row in rows.items():
        cells = [f"{row[key]:>{len(_COLUMNS[key])}.2f}" if row.get(key) is not None else " " * len(_COLUMNS[key])
                 for key in shown]  # fmt: skip
        print("  ".join([f"{name:<{width}}", *cells]))
