"""Basis point sets (Prokudin et al. 2019): a shape as the distances from fixed points to it, the networks' input."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from grabnet.cli.checks import Count, Positive, Seed
from grabnet.errors import UserError
from grabnet.geometry.queries import MeshQuery
from grabnet.io.npz import read_npz

FEATURES = ("dists", "deltas", "closest")


class BPS(nn.Module):
    """Points spread evenly in a ball.

    Args:
        n_points: 4096 in the paper.
        radius: of the ball, metres.
        seed: of the points; the same on every machine.

    Attributes:
        basis (n_points, 3): persistent, since a trained network holds for its own basis only. Neighbours in space are
            mostly neighbours in it, which makes lookups in an atlas twice as fast.
    """

    def __init__(self, n_points: Count = 4096, radius: Positive = 0.15, seed: Seed = 0):
        super().__init__()
        if n_points < 1:
            raise UserError(f"n_points is {n_points}; a basis needs at least 1 point.")
        generator = torch.Generator().manual_seed(seed)
        direction = torch.randn(n_points, 3, generator=generator, dtype=torch.float64)
        length = torch.rand(n_points, 1, generator=generator, dtype=torch.float64) ** (1 / 3)
        basis = radius * length * nn.functional.normalize(direction, dim=-1)
        self.register_buffer("basis", basis[_z_order(basis)].float())

    @classmethod
    def load(cls, path: str | Path) -> BPS:
        """The published points: `basis` (1, P, 3) or (P, 3) of a `bps.npz`, metres.

        Raises:
            UserError: unreadable, or no such array of finite numbers.
        """
        basis = np.asarray(read_npz(path).get("basis"))
        numeric = basis.dtype.kind in "fiu" and np.isfinite(basis).all()
        if not numeric or basis.ndim not in (2, 3) or basis.shape[-1] != 3:
            raise UserError(f"{path} holds no basis of points (P, 3).")
        points = torch.as_tensor(basis, dtype=torch.float32).reshape(-1, 3)
        bps = cls(len(points))
        bps.basis.copy_(points)
        return bps

    def encode(
        self, points: Tensor, feature_type: Sequence[str] = ("dists",), chunk: int = 1 << 25
    ) -> dict[str, Tensor]:
        """Nearest of each cloud's points to every basis point, by brute force.

        Args:
            points: (B, N, 3) or (N, 3), centred where the basis is.
            feature_type: any of "dists" (B, P) metres; "deltas" (B, P, 3) from basis point to nearest point;
                "closest" (B, P, 3) the nearest points themselves.
            chunk: distances held at a time.
        """
        if unknown := set(feature_type) - set(FEATURES):
            raise ValueError(f"feature_type {sorted(unknown)} is not known; choose from {FEATURES}")
        points = points if points.dim() == 3 else points.unsqueeze(0)
        rows = max(1, chunk // max(1, points.shape[0] * points.shape[1]))
        exact = "donot_use_mm_for_euclid_dist"  # dot products are faster, but cancel near the basis points
        nearest = [torch.cdist(b, points, compute_mode=exact).argmin(-1) for b in self.basis.to(points).split(rows)]
        index = torch.cat(nearest, -1)
        closest = points.gather(1, index.unsqueeze(-1).expand(-1, -1, 3))
        deltas = closest - self.basis
        features = {"dists": deltas.norm(dim=-1), "deltas": deltas, "closest": closest}
        return {name: features[name] for name in feature_type}

    def in_object_frame(self, rotations: Tensor, centroids: Tensor) -> Tensor:
        """The basis (B, P, 3) as seen by objects of rotation (B, 3, 3) whose centroids (B, 3) lie at its origin."""
        return self.basis @ rotations + centroids.unsqueeze(1)

    def from_mesh(self, query: MeshQuery, rotation: Tensor, centroid: Tensor) -> Tensor:
        """Exact distances (P,) from the basis to one mesh's surface; `PlacedObjects.basis_distances` is nearly that."""
        basis = self.in_object_frame(rotation.unsqueeze(0), centroid.unsqueeze(0))[0]
        return query.closest(basis).distance


def _z_order(points: Tensor) -> Tensor:
    """Order (N,) along a Z-order curve: by the interleaved bits of the coordinates."""
    lowest = points.amin(0)
    grid = ((points - lowest) / (points.amax(0) - lowest).max() * 1023).long()
    key = sum(((grid[:, axis] >> bit) & 1) << (3 * bit + axis) for bit in range(10) for axis in range(3))
    return key.argsort(stable=True)
