"""CoarseNet: a conditional variational autoencoder of grasps, given an object's basis point set (paper 4, ref. 6)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor
from torch.distributions import Normal
from torch.nn import functional as F

from grabnet.body.hand import HandModel, HandParameters
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.geometry.placed import PlacedObjects
from grabnet.geometry.rotations import matrix_to_six_d, six_d_to_matrix
from grabnet.models.generator import SavedNetwork
from grabnet.models.layers import BatchNorm, Head, ResidualBlock, concatenate
from grabnet.models.published import COARSENET, CONVENTIONS, PublishedWeights


class CoarseNet(SavedNetwork):
    """Object shape and latent code → hand pose, in the object-centred world frame.

    Args:
        bps: the basis that objects are encoded in; part of the network, saved with it.
        latent_dim: size of the latent code.
        width: features between the residual blocks.
        n_hidden: features inside a residual block.
        n_joints: hand joints including the wrist.
    """

    sees = ("centre", "basis")

    def __init__(self, bps: BPS, latent_dim: int = 16, width: int = 512, n_hidden: int = 256, n_joints: int = 16):
        super().__init__()
        if latent_dim < 1:
            raise UserError(f"latent_dim is {latent_dim}; a latent code needs at least 1 dimension.")
        self.bps = bps
        self.latent_dim = latent_dim
        n_bps = len(bps.basis)
        n_encoder, n_decoder = n_bps + 12, n_bps + latent_dim
        self.encoder_norm = BatchNorm(n_encoder)
        self.encoder1 = ResidualBlock(n_encoder, width, n_hidden)
        self.encoder2 = ResidualBlock(n_encoder + width, width, n_hidden)
        self.mean = Head(width, latent_dim)
        self.deviation = Head(width, latent_dim)

        self.decoder_norm = BatchNorm(n_bps)
        self.decoder1 = ResidualBlock(n_decoder, width, n_hidden)
        self.decoder2 = ResidualBlock(n_decoder + width, width, n_hidden)
        self.pose = Head(width, n_joints * 6)
        self.transl = Head(width, 3)
        # Training starts from about the flat hand. From the layer's own random start most joints begin bent by 90° and
        # more, and many stay in such folds for thousands of steps.
        with torch.no_grad():
            self.pose.weight.mul_(0.1)
            self.pose.bias.copy_(matrix_to_six_d(torch.eye(3)).repeat(n_joints))
        # Nor should thousands of basis points drown the wrist and the code: at the start either side weighs the same.
        for block in (self.encoder1, self.encoder2):
            _amplify(block, slice(n_bps, n_encoder), (n_bps / 12) ** 0.5)
        for block in (self.decoder1, self.decoder2):
            _amplify(block, slice(0, latent_dim), (n_bps / latent_dim) ** 0.5)

    @classmethod
    def from_published(cls, path: str | Path, basis: str | Path | None = None) -> CoarseNet:
        """The published network, in eval mode.

        Args:
            path: of `coarsenet.pt`.
            basis: of the published `bps.npz`, whose points the weights hold for. Without it the network's own `bps` is
                another one, and only features that were made with the published points may be given to it.

        Raises:
            UserError: unreadable, or names or shapes that are not the published network's.
        """
        weights = PublishedWeights(path, COARSENET)
        n_bps = weights.size("dec_bn1.weight", 0, 4096)
        network = cls(
            BPS(n_bps) if basis is None else BPS.load(basis),
            latent_dim=weights.size("enc_mu.weight", 0, 16),
            width=weights.size("enc_mu.weight", 1, 512),
            n_hidden=weights.size("enc_rb1.fc1.weight", 0, 256),
        )
        weights.fill(network)
        network.conventions = CONVENTIONS
        return network.eval()

    def arguments(self) -> dict[str, int | float]:
        return {
            "latent_dim": self.latent_dim,
            "width": self.encoder1.fc2.out_features,
            "n_hidden": self.encoder1.fc1.out_features,
            "n_joints": self.pose.out_features // 6,
        }

    @classmethod
    def rebuild(
        cls, arguments: Mapping[str, int | float], tensors: Mapping[str, Tensor], hand: HandModel | None
    ) -> CoarseNet:
        return cls(BPS(len(tensors["bps.basis"])), **arguments)  # its points are among the tensors

    def features(self, objects: PlacedObjects) -> Tensor:
        """Distances (B, P) in metres from the basis points to B placed objects: `bps` of the methods below."""
        return objects.basis_distances(self.bps.basis)

    def encode(self, bps: Tensor, global_orient: Tensor, transl: Tensor) -> Normal:
        """Posterior over latent codes (B, latent_dim), given bps (B, P) in metres and the true wrist."""
        x = self.encoder_norm(concatenate(bps, global_orient, transl))
        h = self.encoder2(concatenate(x, self.encoder1(x)))
        return Normal(self.mean(h), F.softplus(self.deviation(h)), validate_args=False)

    def decode(self, z: Tensor, bps: Tensor) -> HandParameters:
        """Hands for latent codes z (B, latent_dim) on objects bps (B, P)."""
        x = concatenate(z, self.decoder_norm(bps))
        h = self.decoder2(concatenate(x, self.decoder1(x)))
        rotations = six_d_to_matrix(self.pose(h).unflatten(1, (-1, 6)))
        return HandParameters.from_rotations(rotations, self.transl(h))

    def forward(self, bps: Tensor, global_orient: Tensor, transl: Tensor) -> tuple[HandParameters, Normal]:
        """Reconstruct: posterior, one sample of it (its mean in eval mode), and the hand decoded from that."""
        posterior = self.encode(bps, global_orient, transl)
        z = posterior.rsample() if self.training else posterior.mean
        return self.decode(z, bps), posterior


@torch.no_grad()
def _amplify(block: ResidualBlock, inputs: slice, factor: float) -> None:
    for layer in (block.fc1, block.fc3):
        layer.weight[:, inputs] *= factor
