from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from grabnet.body.anatomy import vertex_normals
from grabnet.body.whole import BodyModel, BodyParameters
from grabnet.io.shipped import shipped
from grabnet.mosh.layouts import Layout, read_layout
from grabnet.mosh.placing import marker_positions
from grabnet.mosh.priors import PriorConfig, joint_prior
from grabnet.mosh.so3 import exp
from grabnet.mosh.synthesis import in_one_ring

LAYOUTS = shipped("configs") / "mosh/layouts"


class Actor:
    """The open body with 99 markers in the 1-ring of their places, moving smoothly and as the prior expects."""

    def __init__(self, frames: int = 24, seed: int = 0):
        self.body = BodyModel.open()
        self.layout: Layout = read_layout(LAYOUTS / "open_body_grab99.yaml", len(self.body.v_template))
        self.truth = in_one_ring(self.layout, self.body.faces.numpy(), seed)
        generator = torch.Generator().manual_seed(seed)
        prior = joint_prior(self.body, PriorConfig())
        spread = torch.linalg.cholesky(torch.linalg.inv(prior.precision + 1e-9 * torch.eye(3)))
        spread[0], spread[23:25] = 0.3 * torch.eye(3), 0  # the pelvis is free, the eyes carry no markers
        waves = (spread @ torch.randn(3, 55, 3, 1, generator=generator, dtype=torch.float64)).squeeze(-1)
        time = torch.linspace(0, 1, frames).double()[:, None, None]
        turn = prior.mean + 0.5 * (waves[0] + waves[1] * torch.sin(2 * time) + waves[2] * torch.sin(5 * time))
        turn[:, 23:25] = 0
        self.rotations = exp(turn)
        self.transl = torch.stack([time[:, 0, 0], 0 * time[:, 0, 0], 1 + 0.1 * time[:, 0, 0]], 1)
        self.parameters = BodyParameters.from_rotations(self.rotations.float(), self.transl.float())
        self.vertices = self.body(self.parameters).vertices
        normals = vertex_normals(self.vertices, self.body.faces)
        self.markers = marker_positions(self.truth, self.vertices.double().numpy(), normals.double().numpy())
        rest = self.body.v_template.double()
        normals = vertex_normals(rest, self.body.faces).numpy()
        self.latent = torch.as_tensor(marker_positions(self.truth, rest.numpy(), normals))
        self.guess = marker_positions(self.layout, rest.numpy(), normals)
        weights = self.body.weights.numpy()[[marker.vertices[0] for marker in self.layout.markers]]
        self.trunk = weights[:, [0, 3, 6, 9]].sum(1) > 0.6

    def v2v(self, pose, template: torch.Tensor | None = None) -> np.ndarray:
        """(F,) mean distance of vertices, mm."""
        found = self.body(BodyParameters.from_rotations(pose.rotations.float(), pose.transl.float()), template).vertices
        return 1e3 * (found - self.vertices).norm(dim=-1).mean(1).numpy()


def write_csv(path: Path, labels: list[str], positions: np.ndarray, rate: float = 24) -> None:
    """A plain table in metres; empty cells where markers are missing."""
    header = ["frame", "time", *(f"{label}_{axis}" for label in labels for axis in "xyz")]
    rows = [
        ",".join([str(t), f"{t / rate:.6f}", *("" if np.isnan(x) else f"{x:.6f}" for x in frame.ravel())])
        for t, frame in enumerate(positions)
    ]
    path.write_text("\n".join([",".join(header), *rows]) + "\n")


@pytest.fixture(scope="session")
def actor() -> Actor:
    return Actor()
