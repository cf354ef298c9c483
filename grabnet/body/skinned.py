"""What hands and whole bodies share: a template, its shapes, its joints, and posing by linear blend skinning."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from grabnet.body.loading import Shapes, read_model
from grabnet.body.skinning import forward_kinematics, skin, tree_levels
from grabnet.precision import full_precision


class SkinnedModel(nn.Module):
    """A model file as buffers, and its skinning.

    Args:
        path: `.npz` or `.pkl` file.
        shapes, schema: what it must hold; see `read_model`.
        dtype: of all buffers; inputs must match.

    Attributes:
        v_template (V, 3), shapedirs (V, 3, S), J_regressor (J, V), weights (V, J), faces (F, 3) int64, and the
        schema's further arrays.
    """

    def __init__(self, path: str | Path, shapes: Shapes, schema: str, dtype: torch.dtype):
        super().__init__()
        model = read_model(path, shapes, schema)
        self.parents: list[int] = model.pop("parents").tolist()
        self._levels = tree_levels(self.parents)
        # (9·(J - 1), V·3): what each entry of R - I adds to the rest vertices; all zero, and skipped, in the open hand.
        posedirs = model.pop("posedirs")
        self.has_pose_correctives = bool(np.any(posedirs))
        if self.has_pose_correctives:
            model["posedirs"] = posedirs.reshape(-1, posedirs.shape[-1]).T.copy()
        for name, value in model.items():
            tensor = torch.as_tensor(value)
            self.register_buffer(name, tensor.to(dtype) if tensor.is_floating_point() else tensor, False)

    def rest_joints(self, rest: Tensor) -> Tensor:
        """(..., V, 3) rest vertices → (..., J, 3) joints."""
        return self.J_regressor @ rest

    @full_precision
    def pose(self, rotations: Tensor, transl: Tensor, rest: Tensor) -> tuple[Tensor, Tensor]:
        """Vertices (B, V, 3) and joints (B, J, 3), metres.

        Args:
            rotations: (B, J, 3, 3) of each joint relative to its parent, the root first.
            transl: (B, 3) metres, added after turning about the root joint.
            rest: (V, 3) shared or (B, V, 3) rest vertices.
        """
        joints = self.rest_joints(rest)
        joints = joints if joints.dim() == 3 else joints.unsqueeze(0)
        if self.has_pose_correctives:
            feature = (rotations[:, 1:] - torch.eye(3, dtype=rotations.dtype, device=rotations.device)).flatten(1)
            rest = rest + (feature @ self.posedirs).unflatten(1, (-1, 3))
        world, position = forward_kinematics(rotations, joints, self.parents, self._levels)
        position = position + transl.unsqueeze(1)
        offset = position - (world @ joints.unsqueeze(-1)).squeeze(-1)
        return skin(rest, self.weights, world, offset), position


def blended(directions: Tensor, coefficients: Tensor) -> Tensor:
    """(V, 3, n) directions weighed by (..., n) coefficients → (..., V, 3) offsets."""
    return (coefficients @ directions.reshape(-1, directions.shape[-1]).mT).unflatten(-1, (-1, 3))
