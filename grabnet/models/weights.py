"""Trained networks on disk: one safetensors file each, whose header holds all that is needed to rebuild the network."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import nn

from grabnet.body.hand import HandModel
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.io.files import existing, write_bytes
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.refinenet import RefineNet

FILE_NAME = "model.safetensors"


def save_network(
    path: str | Path, network: CoarseNet | RefineNet, provenance: dict[str, Any], matrices: torch.dtype | None = None
) -> None:
    """Write weights and header atomically.

    Args:
        path: of the file.
        network: its sizes are read off its layers.
        provenance: JSON-able record of config, seed, versions and data, kept in the header.
        matrices: type that the layers' matrices, which are nearly all of the file, are rounded to; their own when
            omitted.
    """
    header = {
        "network": type(network).__name__,
        "sizes": json.dumps(_sizes(network)),
        "provenance": json.dumps(provenance),
    }
    tensors = {name: value.detach().cpu().contiguous() for name, value in network.state_dict().items()}
    if matrices is not None:
        layers = {name: value for name, value in tensors.items() if name.endswith(".weight") and value.dim() == 2}
        tensors |= {name: value.to(matrices) for name, value in layers.items()}
    write_bytes(path, save(tensors, header))


def load_coarsenet(path: str | Path) -> CoarseNet:
    """CoarseNet in eval mode from a run folder or a `model.safetensors`."""
    sizes, tensors = _read(path, "CoarseNet")
    bps = BPS(len(tensors["bps.basis"]))  # its points are among the tensors
    return _filled(CoarseNet(bps, **sizes), tensors, path)


def load_refinenet(path: str | Path, hand: HandModel) -> RefineNet:
    """RefineNet in eval mode from a run folder or a `model.safetensors`; `hand` must have its number of vertices."""
    sizes, tensors = _read(path, "RefineNet")
    n_vertices = len(tensors["distance_norm.weight"])
    if n_vertices != len(hand.v_template):
        raise UserError(f"{path} was trained for a hand of {n_vertices} vertices; this one has {len(hand.v_template)}.")
    return _filled(RefineNet(hand, **sizes), tensors, path)


def read_provenance(path: str | Path) -> dict[str, Any]:
    """The record that `save_network` was given; empty for another's file."""
    with _opened(path) as file:
        return json.loads((file.metadata() or {}).get("provenance", "{}"))


def network_kind(path: Path) -> str | None:
    """Which network a weights file holds; None when it is none of ours."""
    try:
        with safe_open(path, "pt") as file:
            return (file.metadata() or {}).get("network")
    except (SafetensorError, OSError):
        return None


def weights_file(path: str | Path) -> Path:
    """The weights in a run folder, or the path itself when it is a file."""
    path = existing(path, "Checkpoint")
    return existing(path / FILE_NAME, "Checkpoint") if path.is_dir() else path


def _sizes(network: CoarseNet | RefineNet) -> dict[str, int | float]:
    if isinstance(network, CoarseNet):
        first = network.encoder1
        return {"latent_dim": network.latent_dim, "width": first.fc2.out_features, "n_hidden": first.fc1.out_features}
    first = network.block1
    return {
        "iterations": network.iterations,
        "width": first.fc2.out_features,
        "n_hidden": first.fc1.out_features,
        "dropout": network.dropout.p,
    }


def _opened(path: str | Path) -> safe_open:
    file = weights_file(path)
    try:
        return safe_open(file, "pt")
    except (SafetensorError, OSError) as error:
        raise UserError(f"{file} is no readable safetensors file ({error}); train it anew.") from None


def _read(path: str | Path, kind: str) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    with _opened(path) as file:
        header = file.metadata() or {}
        if header.get("network") != kind:
            raise UserError(f"{path} holds {header.get('network', 'no grabnet network')}, where {kind} is wanted.")
        return json.loads(header["sizes"]), {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118


def _filled(network: nn.Module, tensors: dict[str, torch.Tensor], path: str | Path) -> Any:
    expected = network.state_dict()
    tensors = {k: v.to(expected[k].dtype) if k in expected else v for k, v in tensors.items()}
    try:
        network.load_state_dict(tensors, strict=True)
    except RuntimeError as error:
        raise UserError(f"{path} does not fit its own header ({' '.join(str(error).split())}).") from None
    return network.eval()
