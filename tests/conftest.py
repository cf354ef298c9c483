"""A tiny data set in GRAB's layout: primitives instead of objects, random hands instead of grasps."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import trimesh

from grabnet.body.hand import HandModel
from grabnet.data.frames import finish_store, write_shard
from grabnet.data.objects import OBJECT_MESHES
from grabnet.generation.grabber import Grabber
from grabnet.geometry.bps import BPS
from grabnet.geometry.rotations import matrix_to_six_d
from grabnet.io.files import replacing
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.grabnet import GrabNet
from grabnet.models.refinenet import RefineNet

TINY_OBJECTS = {
    "ball": lambda: trimesh.creation.icosphere(3, 0.035),
    "block": lambda: trimesh.creation.box((0.05, 0.06, 0.08)).subdivide().subdivide(),
    "can": lambda: trimesh.creation.cylinder(0.03, 0.12),
    "ring": lambda: trimesh.creation.torus(0.04, 0.012),
}


def write_tiny_dataset(root: Path, frames_per_sequence: int = 24, subjects: int = 2) -> Path:
    """Hands on and about each of four primitives, in two subjects' shapes."""
    hand = HandModel.open()
    generator = torch.Generator().manual_seed(0)
    v_template = {f"s{k + 1}": hand.shaped(torch.randn(10, generator=generator)) for k in range(subjects)}
    for name, make in TINY_OBJECTS.items():
        with replacing(root / OBJECT_MESHES / f"{name}.ply") as temporary:
            temporary.write_bytes(make().export(file_type="ply"))
        for subject in v_template:

            def noise(*shape: int, size: float = 1.0) -> torch.Tensor:
                return size * torch.randn(frames_per_sequence, *shape, generator=generator)

            values = {
                "global_orient": noise(3, size=0.3),
                "hand_pose": noise(2, size=0.3) @ hand.hands_components[:2],
                "transl": torch.tensor([0.0, 0.03, 0.0]) + noise(3, size=0.01),
                "object_orient": noise(3, size=0.3),
                "frame": torch.arange(frames_per_sequence),
            }
            write_shard(root / "frames", f"{subject}/{name}_lift_1", subject, name, values, intent="lift")
    finish_store(root / "frames", hand.fingerprint, v_template, TINY_OBJECTS, {"source": "random hands and primitives"})
    return root


@pytest.fixture(scope="session")
def cache_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One cache of signed-distance grids for the whole test run."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="session")
def tiny_dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Root of the tiny data set; not to be written to."""
    return write_tiny_dataset(tmp_path_factory.mktemp("tiny"))


@pytest.fixture(scope="session")
def hand() -> HandModel:
    """The open right hand."""
    return HandModel.open()


@pytest.fixture(scope="session")
def grabber(hand: HandModel) -> Grabber:
    """Untrained small networks whose hands, nearly flat and each different, lie palm down around the object's top; they
    are left as they are drawn."""
    torch.manual_seed(0)
    coarsenet = CoarseNet(BPS(256), width=32, n_hidden=16)
    refinenet = RefineNet(hand, width=32, n_hidden=16)
    palm_down = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    with torch.no_grad():
        rest = matrix_to_six_d(torch.stack([palm_down, *[torch.eye(3)] * 15])).flatten()
        for layer, bias, size in (
            (coarsenet.pose, rest, 0.3),
            (coarsenet.transl, torch.tensor([0.04, 0.0, 0.045]), 0.02),
            (refinenet.pose, torch.zeros(96), 0.05),
            (refinenet.transl, torch.zeros(3), 0.005),
        ):
            layer.weight.mul_(size)
            layer.bias.copy_(bias)
    return Grabber(GrabNet(coarsenet, refinenet), hand, batch_size=16, n_turns=12, optimise=0, candidates=1)
