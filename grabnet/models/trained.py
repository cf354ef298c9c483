"""Finding trained networks: the one the user names, the newest there is, or the shipped one."""

from __future__ import annotations

from pathlib import Path

from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.io.files import sha256
from grabnet.io.shipped import shipped
from grabnet.models.weights import FILE_NAME, network_kind, read_provenance, weights_file

# Both networks, trained on the open data; see its README.
OPEN_GRABBER = shipped("assets") / "open_grabber"


def find_pair(
    coarsenet: str | Path | None = None, refinenet: str | Path | None = None, runs: str | Path = "runs"
) -> tuple[Path, Path]:
    """Weights of a CoarseNet and a RefineNet.

    Args:
        coarsenet, refinenet: run folders or weights files. What is omitted is the newest complete run below `runs`; the
            shipped network where there is none of one kind.

    Raises:
        UserError: no such file.
    """
    newest = _newest(runs)
    kinds = ("CoarseNet", "RefineNet")
    if any(path is None and kind not in newest for kind, path in zip(kinds, (coarsenet, refinenet), strict=True)):
        newest = {kind: weights_file(OPEN_GRABBER / kind.lower()) for kind in kinds}
    named = [weights_file(path) if path is not None else None for path in (coarsenet, refinenet)]
    return named[0] or newest["CoarseNet"], named[1] or newest["RefineNet"]


def find_network(kind: str, path: str | Path | None, runs: str | Path = "runs") -> Path:
    """Weights of a trained network for a training to build on.

    Args:
        kind: "CoarseNet" or "RefineNet".
        path: run folder or weights file; the newest complete run anywhere below `runs` when omitted, but none that went
            on from a trained network of its kind itself: the runs of a sweep do not start from each other.

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
        f"`python train.py model={kind.lower()}`, or name one with {kind.lower()}=<run folder or {FILE_NAME}>."
    )


def check_hand(path: Path, hand: HandModel) -> None:
    """Raise a `UserError` where the network at `path` is known to have been trained with another hand."""
    trained_with = read_provenance(path).get("hand_sha256")
    if trained_with not in (None, sha256(hand.v_template.numpy())):
        raise UserError(f"{path} was trained with another hand model: name its file with hand_model=<MANO_RIGHT.npz>.")


def _newest(runs: str | Path, from_scratch: bool = False) -> dict[str, Path]:
    """The newest weights of each kind of network anywhere below `runs`."""
    files = sorted(Path(runs).rglob(FILE_NAME), key=lambda f: f.stat().st_mtime)
    kinds = ((file, network_kind(file)) for file in files)
    return {kind: file for file, kind in kinds if kind and not (from_scratch and _went_on(file, kind))}


def _went_on(path: Path, kind: str) -> bool:
    """Whether a network's training began with a trained one of its kind."""
    return kind in read_provenance(path).get("trained_from", {})
