"""Weights of the published GrabNet, whose layers have other names than ours (ref. 6)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from torch import Tensor, nn

from grabnet.errors import UserError
from grabnet.geometry.conventions import Conventions
from grabnet.io.checkpoints import read_checkpoint

# What they were trained with (ref. 6 and 7).
CONVENTIONS = Conventions(centre="box", distance_to="samples", basis_to="samples", rotate=False)
# Published name of each of our layers.
COARSENET = {
    "encoder_norm": "enc_bn1",
    "encoder1": "enc_rb1",
    "encoder2": "enc_rb2",
    "mean": "enc_mu",
    "deviation": "enc_var",
    "decoder_norm": "dec_bn1",
    "decoder1": "dec_rb1",
    "decoder2": "dec_rb2",
    "pose": "dec_pose",
    "transl": "dec_trans",
}
REFINENET = {
    "distance_norm": "bn1",
    "block1": "rb1",
    "block2": "rb2",
    "block3": "rb3",
    "pose": "out_p",
    "transl": "out_t",
}
# What published files hold besides: a layer that is never used, and a copy of the hand model.
_IGNORED = ("enc_bn0.", "rhm_train.")


class PublishedWeights:
    """A published state dict.

    Args:
        path: of the file; read without running anything of it.
        names: `COARSENET` or `REFINENET`.

    Raises:
        UserError: unreadable, or no state dict of plain tensors.
    """

    def __init__(self, path: str | Path, names: Mapping[str, str]):
        self.path, self.names = Path(path), names
        stored = read_checkpoint(path, "Published checkpoint", "it must hold plain tensors: download it again")
        if not isinstance(stored, Mapping) or not all(isinstance(value, Tensor) for value in stored.values()):
            raise UserError(f"{path} is no state dict: it must hold tensors by name, as the published files do.")
        self.tensors = {name: value for name, value in stored.items() if not name.startswith(_IGNORED)}

    def size(self, name: str, axis: int, default: int) -> int:
        """Of a tensor along an axis; `default` where there is no such tensor, which `fill` will tell of."""
        tensor = self.tensors.get(name)
        return tensor.shape[axis] if tensor is not None and tensor.dim() > axis else default

    def fill(self, network: nn.Module) -> None:
        """Copy all weights into `network`, which must have exactly these layers.

        Raises:
            UserError: names that are missing or too many, or shapes that differ.
        """
        ours = {self._published(name): name for name in network.state_dict() if self._published(name)}
        expected = {name: network.state_dict()[own] for name, own in ours.items()}
        faults = {
            "lacks": sorted(expected.keys() - self.tensors.keys()),
            "has the unknown": sorted(self.tensors.keys() - expected.keys()),
            "has, in other shapes,": [
                f"{name} {tuple(self.tensors[name].shape)} for {tuple(value.shape)}"
                for name, value in expected.items()
                if name in self.tensors and self.tensors[name].shape != value.shape
            ],
        }
        if said := [f"{what} {', '.join(names)}" for what, names in faults.items() if names]:
            raise UserError(f"{self.path} is no published {type(network).__name__}: it {'; it '.join(said)}.")
        weights = {own: self.tensors[name] for name, own in ours.items()}
        if bad := [self._published(own) for own, value in weights.items() if not value.isfinite().all()]:
            raise UserError(f"{self.path} is no published {type(network).__name__}: its {bad[0]} is not finite.")
        network.load_state_dict(weights, strict=False)  # all names were checked; our basis is not among them

    def _published(self, name: str) -> str | None:
        """Published name of one of our tensors, if it has one."""
        layer, _, rest = name.partition(".")
        return f"{self.names[layer]}.{rest}" if layer in self.names else None
