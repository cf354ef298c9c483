"""Trained models by name: the shipped one, the newest there is, or those in files and folders that the user names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.io.files import existing
from grabnet.io.shipped import shipped
from grabnet.models.generator import GraspGenerator
from grabnet.models.grabnet import GrabNet
from grabnet.models.weights import FILE_NAME, NETWORKS, load_network, network_kind, read_provenance, weights_file

# Both networks, trained on the open data; see its README.
OPEN_GRABBER = shipped("assets") / "open_grabber"
# Folders of a model of several networks, such as a run of model=grabnet.
_PARTS = ("coarsenet", "refinenet")


def find_model(name: str | Path | Sequence[str | Path] = "open", runs: str | Path = "runs") -> dict[str, Path]:
    """Weights files of a model, by kind of network.

    Args:
        name: "open", the shipped one; "newest", the newest below `runs`; a weights file or run folder; a folder with
            run folders `coarsenet` and, optionally, `refinenet`; or a list of files and folders, a network each.
        runs: folder that is searched for "newest".

    Raises:
        UserError: no such file, two networks of one kind, or none that makes grasps.
    """
    if name == "open":
        name = OPEN_GRABBER
    if name == "newest":
        return _newest_model(runs)
    files: dict[str, Path] = {}
    for path in [name] if isinstance(name, str | Path) else name:
        for file in _weights_in(Path(path).expanduser()):
            kind = network_kind(file) or ""
            if kind in files:
                raise UserError(f"{file} and {files[kind]} both hold a {kind}; name one of them.")
            if kind not in NETWORKS:
                raise UserError(f"{file} holds {kind or 'no grabnet network'}; it must hold {', '.join(NETWORKS)}.")
            files[kind] = file
    if not any(_makes_grasps(kind) for kind in files):
        raise UserError(f"{name} holds no network that makes grasps, only {', '.join(files)}; name a CoarseNet, too.")
    return files


def load_model(files: Mapping[str, Path], hand: HandModel, refine: bool = True) -> GraspGenerator:
    """The model of the weights files that `find_model` gave, in eval mode.

    Args:
        files: by kind of network.
        hand: the right hand they were trained with.
        refine: False leaves a RefineNet out.

    Raises:
        UserError: unreadable, trained with another hand, or networks that make no model together, such as two that know
            objects about different centres.
    """
    networks = {kind: load_network(file, hand, kind) for kind, file in files.items() if refine or kind != "RefineNet"}
    if "CoarseNet" in networks and networks.keys() <= {"CoarseNet", "RefineNet"}:
        try:
            return GrabNet(networks["CoarseNet"], networks.get("RefineNet")).eval()
        except UserError as error:
            raise UserError(f"{files['CoarseNet']} and {files['RefineNet']} do not fit each other: {error}") from None
    if len(networks) > 1:
        raise UserError(f"{' and '.join(networks)} are no model together; name one of them.")
    return next(iter(networks.values()))


def find_network(kind: str, path: str | Path | None, runs: str | Path = "runs") -> Path:
    """Weights of a trained network for a training to build on.

    Args:
        kind: "CoarseNet" or "RefineNet".
        path: run folder or weights file; the newest complete run anywhere below `runs` when omitted, but no trial, and
            none that went on from a trained network of its kind itself: the runs of a sweep do not start from each
            other.

    Raises:
        UserError: no such file, or no trained network of this kind below `runs`.
    """
    if path is not None:
        return weights_file(path)
    newest = _newest(runs, from_scratch=True)
    if kind in newest:
        return newest[kind]
    there = ", ".join(f"{file.parent} ({k})" for k, file in sorted(newest.items())) or "no trained network"
    raise UserError(
        f"There is no trained {kind} below {runs}, which holds {there}: train one with `make demo` or "
        f"`python train.py model={kind.lower()}`, or name one with model.{kind.lower()}=<run folder or {FILE_NAME}>."
    )


def _weights_in(path: Path) -> list[Path]:
    """The weights file at a path, or those of the parts in a folder of several."""
    path = existing(path, 'Only "open", "newest", a file or a folder can be named:')
    parts = [path / part / FILE_NAME for part in _PARTS]
    if path.is_dir() and not (path / FILE_NAME).exists() and parts[0].exists():
        return [part for part in parts if part.exists()]
    return [weights_file(path)]


def _newest_model(runs: str | Path) -> dict[str, Path]:
    newest = _newest(runs)
    makers = [kind for kind in newest if _makes_grasps(kind)]  # the newest one comes last
    if not makers:
        there = ", ".join(f"{file.parent} ({kind})" for kind, file in newest.items()) or "no trained network"
        raise UserError(f"There is no network that makes grasps below {runs}, which holds {there}: use model=open.")
    kinds = (makers[-1], "RefineNet") if makers[-1] == "CoarseNet" else makers[-1:]
    return {kind: newest[kind] for kind in kinds if kind in newest}


def _makes_grasps(kind: str) -> bool:
    return kind == "CoarseNet" or issubclass(NETWORKS[kind], GraspGenerator)


def _newest(runs: str | Path, from_scratch: bool = False) -> dict[str, Path]:
    """The newest weights of each kind of network anywhere below `runs`, the newest of all last; none of a trial."""
    files = sorted(Path(runs).expanduser().rglob(FILE_NAME), key=lambda f: f.stat().st_mtime)
    newest: dict[str, Path] = {}
    for file in files:
        kind = network_kind(file)
        if kind in NETWORKS and not is_trial(file) and not (from_scratch and _went_on(file, kind)):
            newest.pop(kind, None)
            newest[kind] = file
    return newest


def is_trial(path: Path) -> bool:
    """Whether a network's training was only tried out, as debug=default does."""
    config = read_provenance(path).get("config")
    return isinstance(config, dict) and bool(config.get("trial"))


def _went_on(path: Path, kind: str) -> bool:
    """Whether a network's training began with a trained one of its kind."""
    return kind in (read_provenance(path).get("trained_from") or {})
