"""The parametric whole body: any model in SMPL-X's schema, posed by linear blend skinning."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from grabnet.body.loading import BODY_SHAPES
from grabnet.body.skinned import SkinnedModel, blended
from grabnet.io.shipped import shipped

OPEN_BODY = shipped("assets") / "open_body"
N_BODY_JOINTS, N_HAND_JOINTS = 21, 15
# Shape directions of a model file: with 400, the first 300 are of the body and the rest of the face; the older,
# smaller files hold ten of each.
_EXPRESSION_STARTS = {400: 300}
_OLDER_EXPRESSION_START = 10


class BodyParameters(NamedTuple):
    """Pose of a batch of bodies; each joint relative to its parent, hands in the model's order of joints.

    global_orient: (B, 3, 3) pelvis. body_pose: (B, 21, 3, 3). jaw_pose, leye_pose, reye_pose: (B, 3, 3).
    left_hand_pose, right_hand_pose: (B, 15, 3, 3). transl: (B, 3) metres, added after rotating about the pelvis.
    """

    global_orient: Tensor
    body_pose: Tensor
    jaw_pose: Tensor
    leye_pose: Tensor
    reye_pose: Tensor
    left_hand_pose: Tensor
    right_hand_pose: Tensor
    transl: Tensor

    @classmethod
    def from_rotations(cls, rotations: Tensor, transl: Tensor) -> BodyParameters:
        """From all 55 joints' rotations (B, 55, 3, 3), the pelvis first: GRAB's `fullpose` as matrices."""
        sizes = (1, N_BODY_JOINTS, 1, 1, 1, N_HAND_JOINTS, N_HAND_JOINTS)
        parts = rotations.split(sizes, 1)
        return cls(*(part.squeeze(1) if n == 1 else part for part, n in zip(parts, sizes, strict=True)), transl)

    @property
    def rotations(self) -> Tensor:
        """All joints' rotations, the pelvis first: (B, 55, 3, 3)."""
        return torch.cat([part if part.dim() == 4 else part.unsqueeze(1) for part in self[:-1]], 1)


class Body(NamedTuple):
    """Posed bodies: vertices (B, V, 3) and joints (B, 55, 3), metres, in the frame of their parameters."""

    vertices: Tensor
    joints: Tensor


class BodyModel(SkinnedModel):
    """A whole body in SMPL-X's schema: 55 joints, the pelvis first; jaw and eyes are 22 to 24, hands 25 to 54.

    Args:
        path: `.npz` or `.pkl` file.
        dtype: of all buffers; inputs must match.

    Attributes:
        n_betas, n_expressions: shape and expression directions of the file.
        hands_meanl, hands_meanr (45,) and hands_componentsl, hands_componentsr (45, 45) in axis-angle, for PCA poses.
    """

    def __init__(self, path: str | Path, dtype: torch.dtype = torch.float32):
        super().__init__(path, BODY_SHAPES, "SMPL-X", dtype)
        n = self.shapedirs.shape[-1]
        self.n_betas = min(n, _EXPRESSION_STARTS.get(n, _OLDER_EXPRESSION_START))
        self.n_expressions = n - self.n_betas

    @classmethod
    def open(cls) -> BodyModel:
        """The open stand-in shipped with the package (CC0, from MakeHuman); of no gender."""
        return cls(OPEN_BODY / "SMPLX_NEUTRAL.npz")

    def shaped(
        self, betas: Tensor | None = None, expression: Tensor | None = None, v_template: Tensor | None = None
    ) -> Tensor:
        """Rest vertices (..., V, 3).

        Args:
            betas: (..., up to n_betas) shape; the template's own when omitted.
            expression: (..., up to n_expressions); the face at rest when omitted.
            v_template: (V, 3) of a subject, which replaces betas in GRAB; the model's own when omitted.
        """
        rest = self.v_template if v_template is None else v_template
        for name, values, start, most in (
            ("betas", betas, 0, self.n_betas),
            ("expression values", expression, self.n_betas, self.n_expressions),
        ):
            if values is None:
                continue
            if (n := values.shape[-1]) > most:
                raise ValueError(f"{n} {name} given, but this body model has {most}")
            rest = rest + blended(self.shapedirs[..., start : start + n], values)
        return rest

    def hand_pose_from_pca(self, components: Tensor, side: str, flat_hand_mean: bool = False) -> Tensor:
        """(..., n) principal components of a `side`, left or right → (..., 45) axis-angle.

        Added to the model's mean pose, as those of GRAB's bodies are (ref. 1), unless `flat_hand_mean`.
        """
        pose = components @ getattr(self, f"hands_components{side[0]}")[: components.shape[-1]]
        return pose if flat_hand_mean else pose + getattr(self, f"hands_mean{side[0]}")

    def forward(self, parameters: BodyParameters, rest: Tensor | None = None) -> Body:
        """Pose the body.

        Args:
            parameters: a batch of B poses.
            rest: rest vertices, (V, 3) shared or (B, V, 3), from `shaped`; the model's own template when omitted.
        """
        return Body(*self.pose(parameters.rotations, parameters.transl, self.v_template if rest is None else rest))
