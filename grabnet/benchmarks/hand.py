"""Posing a batch of hands, against the package that the field uses."""

from __future__ import annotations

import contextlib
import io

import torch

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import hands
from grabnet.benchmarks.timing import Case
from grabnet.body.hand import OPEN_HANDS, HandParameters
from grabnet.errors import UserError
from grabnet.geometry.rotations import matrix_to_axis_angle


def cases(settings: BenchmarkConfig) -> list[Case]:
    try:
        import smplx
    except ImportError:
        raise UserError("The hand suite compares with the package smplx: pip install smplx.") from None
    hand, poses = hands(settings.batch, torch.Generator().manual_seed(settings.seed), settings.device)
    path = OPEN_HANDS / "MANO_RIGHT.npz"
    with contextlib.redirect_stdout(io.StringIO()):  # it prints about betas
        other = smplx.MANO(str(path), ext="npz", use_pca=False, flat_hand_mean=True, batch_size=settings.batch)
    other = other.to(settings.device)
    wrist = matrix_to_axis_angle(poses.global_orient)
    fingers = matrix_to_axis_angle(poses.hand_pose).flatten(1)

    def ours(backward: bool) -> None:
        parameters = HandParameters(*(x.clone().requires_grad_(backward) for x in poses))
        vertices = hand(parameters).vertices
        if backward:
            vertices.sum().backward()

    def theirs(backward: bool) -> None:
        transl, orient, pose = (x.clone().requires_grad_(backward) for x in (poses.transl, wrist, fingers))
        vertices = other(global_orient=orient, hand_pose=pose, transl=transl).vertices
        if backward:
            vertices.sum().backward()

    return [
        Case("smplx, forward", lambda: theirs(False)),
        Case("forward", lambda: ours(False), ("smplx, forward",)),
        Case("smplx, forward and backward", lambda: theirs(True)),
        Case("forward and backward", lambda: ours(True), ("smplx, forward and backward",)),
    ]
