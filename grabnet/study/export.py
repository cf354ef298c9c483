"""Export of a study: the served folder with videos and page, and the private one with the key."""

from __future__ import annotations

import hmac
import json
import re
import secrets
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from grabnet.errors import UserError
from grabnet.io.files import sha256, write_bytes, write_json
from grabnet.io.provenance import provenance
from grabnet.study.conditions import Grasp, study_grasps
from grabnet.study.config import ExportConfig
from grabnet.study.films import Scene, Set, film
from grabnet.study.key import ANSWERS, CATCH, EXAMPLE, PRIVATE, SECRET, SITE, Shown, StudyKey
from grabnet.study.store import AnswerStore
from grabnet.study.trials import balanced_lists, paired_cells, rating_cells
from grabnet.visual.turntable import FilmConfig

_PAGE = Path(__file__).with_name("page")
_COMPLETION = "https://app.prolific.com/submissions/complete?cc="


def run(config: ExportConfig) -> int:
    """Export the study that the config describes; what is there of it already stays.

    Returns:
        the exit code.

    Raises:
        UserError: grasps that cannot be had, no means to draw, or answers there to another study.
    """
    made = study_grasps(config)
    secret = _secret(config.folder)
    sets = {
        name: Set.of(mesh, [grasp.vertices for grasp in made.grasps if grasp.shown.object == name], config.film)
        for name, mesh in made.meshes.items()
    }
    grasps = {_name(secret, grasp, sets[grasp.shown.object], config.film): grasp for grasp in made.grasps}
    grasps = dict(sorted(grasps.items()))  # the order of random names
    key = _key(config, made.conditions, {name: grasp.shown for name, grasp in grasps.items()}, made.record, secret)
    with AnswerStore(config.folder / PRIVATE / ANSWERS) as store:  # which no server uses meanwhile
        _refuse_other_answers(config.folder, store, key.study)
        _write(config, key, grasps, sets)
    return 0


def _write(config: ExportConfig, key: StudyKey, grasps: Mapping[str, Grasp], sets: Mapping[str, Set]) -> None:
    scenes = [Scene(name, g.vertices, g.faces, g.shown.object) for name, g in grasps.items()]
    site = config.folder / SITE
    new = film(scenes, sets, site, config.film, config.processes)
    key.write(config.folder)
    _write_page(site, config, key)
    trials = f"{len(key.lists)} lists of {len(key.lists[0])} trials"
    print(f"{config.folder}: {len(scenes)} videos, {new} of them new; {trials}")
    print(f"  {site} is to be served: grabnet study serve export={config.folder}")
    print(f"  {config.folder / PRIVATE} tells what the videos show: keep it to yourself")


def _secret(folder: Path) -> bytes:
    path = folder / PRIVATE / SECRET
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.parent.chmod(0o700)
        write_bytes(path, secrets.token_hex(32).encode())
        path.chmod(0o600)
    secret = path.read_bytes()
    if not re.fullmatch(rb"[0-9a-f]{64}", secret):
        raise UserError(f"{path} is damaged: choose another output, or remove the export.")
    return secret


def _name(secret: bytes, grasp: Grasp, shared: Set, config: FilmConfig) -> str:
    """A name that tells nothing to whoever lacks the secret, and is the same for the same video."""
    shown = json.dumps([asdict(grasp.shown), shared.distance, asdict(config)], sort_keys=True)
    content = sha256(shown, grasp.vertices, grasp.faces, shared.solid.vertices, shared.solid.faces)
    return hmac.new(secret, content.encode(), "sha256").hexdigest()[:20]


def _key(
    config: ExportConfig, conditions: list[str], videos: dict[str, Shown], record: dict, secret: bytes
) -> StudyKey:
    rng = np.random.default_rng(list(secret))
    rated = {name: shown for name, shown in videos.items() if shown.condition != EXAMPLE}
    cells = rating_cells(rated) if config.kind == "rating" else paired_cells(rated, conditions, rng)
    shown = {cell: config.catches_shown if cell[-1] == CATCH else config.shown for cell in cells}
    lists = balanced_lists(cells, shown, config.lists, rng)
    public = json.dumps([config.kind, config.levels, asdict(config.text), sorted(videos), lists])
    facts = {"config": asdict(config), "provenance": provenance()}
    study = sha256(secret, public)[:16]
    return StudyKey(study, config.kind, config.levels, conditions, videos, lists, record | facts)


def _refuse_other_answers(folder: Path, store: AnswerStore, study: str) -> None:
    if store.path.stat().st_size and StudyKey.read(folder).study != study:
        raise UserError(f"{store.path} holds answers to the study as it was before: choose another output.")


def _write_page(site: Path, config: ExportConfig, key: StudyKey) -> None:
    text, paired = config.text, config.kind == "paired"
    code = config.completion_code
    study = {
        "study": key.study,
        "kind": key.kind,
        "size": config.film.size,
        "title": text.title,
        "statement": text.question if paired else text.statement,
        "levels": key.levels,
        "consent": _paragraphs(text.consent),
        "instructions": _paragraphs(text.instructions_paired if paired else text.instructions),
        "examples": _examples(key, [text.plausible, text.implausible]),
        "thanks": text.thanks,
        "completion": None if code is None else _COMPLETION + code,
        "lists": key.lists,
    }
    for path in sorted(_PAGE.rglob("*")):
        if path.is_file():
            target = site / path.relative_to(_PAGE)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
    write_json(site / "study.json", study)


def _examples(key: StudyKey, about: Sequence[str]) -> list[dict[str, str]]:
    videos = {name: shown for name, shown in key.videos.items() if shown.condition == EXAMPLE}
    ordered = sorted(videos, key=lambda name: videos[name].perturbation is not None)
    return [{"video": name, "text": text} for name, text in zip(ordered, about, strict=True)]


def _paragraphs(text: str) -> list[str]:
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]
