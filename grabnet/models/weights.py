"""Trained networks on disk: one safetensors file each, whose header holds all that is needed to rebuild the network."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save
from torch.utils._python_dispatch import TorchDispatchMode

from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.geometry.conventions import Conventions
from grabnet.io.files import existing, write_bytes
from grabnet.io.state import Finite, Kind, parsed_json
from grabnet.io.tensors import Tensors, check_tensors, fact, header_facts, read_tensors
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.generator import SavedNetwork
from grabnet.models.refinenet import RefineNet

FILE_NAME = "model.safetensors"
# Every network that a weights file may name. A file never names a place to import from.
NETWORKS: dict[str, type[SavedNetwork]] = {"CoarseNet": CoarseNet, "RefineNet": RefineNet}
_REMEDY = "train it again"
# Of the header.
_SIZES: Kind = {str: Finite(0)}
_CONVENTIONS: Kind = {"object_points?": int, "points_in_use?": int, "rotate?": bool, "hand?": (str, None)}
_PROVENANCE: Kind = {"trained_from?": ({str: object}, None), "hand_sha256?": (str, None)}
# Points of an object that conventions may name: fifty times what any network was trained with.
_MAX_POINTS = 1_000_000


def save_network(
    path: str | Path, network: SavedNetwork, provenance: dict[str, Any], matrices: torch.dtype | None = None
) -> None:
    """Write weights and header, its conventions among it, atomically.

    Args:
        path: of the file.
        network: of a class in `NETWORKS`.
        provenance: JSON-able record of config, seed, versions and data, kept in the header.
        matrices: type that the layers' matrices, which are nearly all of the file, are rounded to; their own when
            omitted.
    """
    header = {
        "network": type(network).__name__,
        "sizes": json.dumps(network.arguments()),
        "conventions": json.dumps(asdict(network.conventions)),
        "provenance": json.dumps(provenance),
    }
    tensors = {name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}
    if matrices is not None:
        layers = {name: value for name, value in tensors.items() if name.endswith(".weight") and value.dim() == 2}
        tensors |= {name: value.to(matrices) for name, value in layers.items()}
    write_bytes(path, save(tensors, header))


def load_network(path: str | Path, hand: HandModel | None = None, kind: str | None = None) -> SavedNetwork:
    """A network in eval mode from a run folder or a `model.safetensors`.

    Args:
        path: of the folder or file.
        hand: the hand model it was trained with; None for a network that poses none, which is then not checked.
        kind: the key of `NETWORKS` that the file must name; any when omitted.

    Raises:
        UserError: unreadable, another network, trained with another hand, or tensors that do not fit the header.
    """
    stored = read_tensors(weights_file(path), "Checkpoint", _REMEDY)
    held = stored.facts.get("network")
    if held not in NETWORKS or kind not in (None, held):
        known = kind or f"one of {', '.join(NETWORKS)}"
        raise UserError(f"{path} holds {held or 'no grabnet network'}; it must hold {known}.")
    if hand is not None:
        check_hand(path, hand)
    sizes = fact(stored, "sizes", _SIZES, _REMEDY)
    try:
        with _NothingLargerThan(stored):
            network = NETWORKS[held].rebuild(sizes, stored.values, hand)
    except UserError as error:
        raise UserError(f"{path} cannot be used: {error}") from None
    except (AttributeError, KeyError, RuntimeError, TypeError, ValueError, ArithmeticError) as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise UserError(f"{path} does not fit the {held} of this version ({reason}); train it again.") from None
    network.conventions = read_conventions(path)
    return _filled(network, stored, path)


def check_savable(network: SavedNetwork, hand: HandModel) -> None:
    """Raise a `UserError` where `network` could not be saved and loaded again: before it is trained, not after."""
    kind = type(network)
    if NETWORKS.get(kind.__name__) is not kind:
        raise UserError(
            f"{kind.__name__} cannot be saved: add it to NETWORKS in grabnet/models/weights.py, which has "
            f"{', '.join(NETWORKS)}."
        )
    tensors = network.state_dict()
    try:
        copy = kind.rebuild(json.loads(json.dumps(network.arguments())), tensors, hand)
        copy.load_state_dict(tensors, strict=True)
    except (AttributeError, TypeError, ValueError, KeyError, RuntimeError, UserError) as error:
        reason = " ".join(str(error).split())
        raise UserError(f"{kind.__name__} cannot be rebuilt from its own arguments() and weights: {reason}") from None


def check_hand(path: str | Path, hand: HandModel) -> None:
    """Raise a `UserError` where the network at `path` is known to have been trained with another hand."""
    # Files without conventions name the hand in their provenance.
    trained_with = read_conventions(path).hand or read_provenance(path).get("hand_sha256")
    if trained_with is not None and not hand.is_named_by(trained_with):
        raise UserError(
            f"{path} was trained with another hand model: give that one, with hand_model=<its file> when sampling, "
            "else with hand_model=mano hand_model.path=<its file>."
        )


def check_conventions(files: Mapping[str, Path], shown: Conventions) -> None:
    """Raise a `UserError` where one of several networks would see objects otherwise than it was trained to.

    Args:
        files: weights files, by kind of network.
        shown: conventions that the objects are shown by.
    """
    for kind, path in files.items():
        remedy = "give the values that it was trained with, or another network"
        read_conventions(path).check_shown(str(path), shown, NETWORKS[kind].sees, remedy)


def read_conventions(path: str | Path) -> Conventions:
    """What a network was trained with; of a file that does not say it, the defaults.

    Raises:
        UserError: unreadable, or conventions that are not known here.
    """
    held = _header(path).get("conventions", "{}")
    try:
        known = Conventions(**parsed_json(held, _CONVENTIONS))
        if max(known.object_points, known.points_in_use) > _MAX_POINTS:
            raise ValueError(f"more than {_MAX_POINTS:,} points of an object")
    except (TypeError, ValueError, UserError) as error:
        raise UserError(f"{path} was trained with conventions that are not known here ({error}).") from None
    return known


def read_provenance(path: str | Path) -> dict[str, Any]:
    """The record that `save_network` was given; empty for another's file.

    Raises:
        UserError: unreadable, or no record.
    """
    try:
        return parsed_json(_header(path).get("provenance", "{}"), _PROVENANCE)
    except ValueError as error:
        raise UserError(f"{path} has a damaged record of its training ({error}): {_REMEDY}.") from None


def network_kind(path: Path) -> str | None:
    """Which network a weights file holds; None when it is none of ours."""
    return (header_facts(path) or {}).get("network")


def weights_file(path: str | Path) -> Path:
    """The weights in a run folder, or the path itself when it is a file."""
    path = existing(path, "Checkpoint")
    return existing(path / FILE_NAME, "Checkpoint") if path.is_dir() else path


def _header(path: str | Path) -> dict[str, str]:
    file = weights_file(path)
    if (header := header_facts(file)) is None:
        raise UserError(f"{file} is no readable safetensors file: {_REMEDY}.")
    return header


class _NothingLargerThan(TorchDispatchMode):
    """Refuses tensors far larger than any in a file: a network that needs such is not the one that it holds.

    Memory is taken where tensors are filled, which they are not yet.
    """

    def __init__(self, stored: Tensors):
        super().__init__()
        # Eightfold: the basis is drawn in double precision, matrices may be stored in half.
        self._most = 8 * max((value.nbytes for value in stored.values.values()), default=0) + (1 << 20)

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = function(*args, **(kwargs or {}))
        if isinstance(result, torch.Tensor) and result.nbytes > self._most:
            raise ValueError(f"sizes that need a tensor of shape {tuple(result.shape)}, which it doesn't hold")
        return result


def _filled(network: SavedNetwork, stored: Tensors, path: str | Path) -> SavedNetwork:
    expected = network.state_dict()
    floats = {name: tuple(v.shape) for name, v in expected.items() if v.is_floating_point() and name in stored.values}
    check_tensors(stored, floats, _REMEDY)
    tensors = {k: v.to(expected[k].dtype) if k in expected else v for k, v in stored.values.items()}
    try:
        network.load_state_dict(tensors, strict=True)
    except RuntimeError as error:
        raise UserError(f"{path} does not fit its own header ({' '.join(str(error).split())}).") from None
    return network.eval()
