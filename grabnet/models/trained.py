"""Finding trained networks: the one the user names, or the newest there is."""

from __future__ import annotations

from pathlib import Path

from safetensors import SafetensorError, safe_open

from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.files import sha256
from grabnet.models.weights import FILE_NAME, read_provenance, weights_file


def find_network(kind: str, path: str | Path | None, runs: str | Path = "runs") -> Path:
    """Weights of a trained network.

    Args:
        kind: "CoarseNet" or "RefineNet".
        path: run folder or weights file; the newest complete run anywhere below `runs` when omitted.

    Raises:
        UserError: no such file, or no trained network of this kind below `runs`.
    """
    if path is not None:
        return weights_file(path)
    found = {file: _kind(file) for file in Path(runs).rglob(FILE_NAME)}
    if newest := max((f for f, k in found.items() if k == kind), key=lambda f: f.stat().st_mtime, default=None):
        return newest
    there = ", ".join(f"{file.parent} ({k})" for file, k in sorted(found.items()) if k) or "no trained network"
    raise UserError(
        f"There is no trained {kind} below {runs}, which holds {there}: train one with `make demo` or "
        f"`python train.py model={kind.lower()}`, or name one with {kind.lower()}=<run folder or {FILE_NAME}>."
    )


def check_hand(path: Path, hand: HandModel) -> None:
    """Raise a `UserError` where the network at `path` is known to have been trained with another hand."""
    trained_with = read_provenance(path).get("hand_sha256")
    if trained_with not in (None, sha256(hand.v_template.numpy())):
        raise UserError(f"{path} was trained with another hand model: name its file with hand_model=<MANO_RIGHT.npz>.")


def _kind(path: Path) -> str | None:
    """Which network a weights file holds; None when it is none of ours."""
    try:
        with safe_open(path, "pt") as file:
            return (file.metadata() or {}).get("network")
    except (SafetensorError, OSError):
        return None
