"""The parametric hand: any model in MANO's schema, ours or the licensed one, posed by linear blend skinning."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from grabnet.body.left_hand import unmirrored
from grabnet.body.loading import HAND_SHAPES
from grabnet.body.skinned import SkinnedModel, blended
from grabnet.errors import printable
from grabnet.io.files import sha256
from grabnet.io.shipped import shipped

OPEN_HANDS = shipped("assets") / "open_hand"


class HandParameters(NamedTuple):
    """Pose of a batch of hands, in whatever frame the caller works in.

    global_orient: (B, 3, 3) wrist rotation. hand_pose: (B, 15, 3, 3) finger joints relative to their parents, in the
    model's order (index, middle, pinky, ring, thumb). transl: (B, 3) metres, added after rotating about the wrist.
    """

    global_orient: Tensor
    hand_pose: Tensor
    transl: Tensor

    @classmethod
    def from_rotations(cls, rotations: Tensor, transl: Tensor) -> HandParameters:
        """From all 16 joints' rotations (B, 16, 3, 3), the wrist first."""
        return cls(rotations[:, 0], rotations[:, 1:], transl)

    @property
    def rotations(self) -> Tensor:
        """All joints' rotations, the wrist first: (B, 16, 3, 3)."""
        return torch.cat([self.global_orient.unsqueeze(1), self.hand_pose], 1)

    def select(self, index: Tensor | slice) -> HandParameters:
        """The chosen batch elements."""
        return HandParameters(*(x[index] for x in self))


class Hand(NamedTuple):
    """Posed hands: vertices (B, V, 3) and joints (B, 16, 3), metres, in the frame of their parameters."""

    vertices: Tensor
    joints: Tensor


class HandModel(SkinnedModel):
    """A hand in MANO's schema: 16 joints, the wrist first.

    Args:
        path: `.npz` or `.pkl` file, with LEFT in its name for a left hand; `HandModel.open("right")` loads the open
            stand-in.
        dtype: of all buffers; inputs must match.

    A left hand whose shapes are not mirrored, as in the published file, is mended with a warning (ref. 1).

    Attributes:
        v_template (V, 3), shapedirs (V, 3, n_betas), J_regressor (16, V), weights (V, 16), faces (F, 3) int64;
        hands_mean (45,) and hands_components (45, 45) in axis-angle, for PCA poses.
    """

    def __init__(self, path: str | Path, dtype: torch.dtype = torch.float32):
        super().__init__(path, HAND_SHAPES, "MANO", dtype)
        self.is_right = "LEFT" not in Path(path).stem.upper()
        if not self.is_right:
            self._mirror_shapes(path)

    def _mirror_shapes(self, path: str | Path) -> None:
        """Mend a left hand's shape directions where they are not mirrored as its template is."""
        model = {"v_template": self.v_template.numpy(), "shapedirs": self.shapedirs.numpy()}
        wrong = torch.as_tensor(unmirrored(path, model, HAND_SHAPES))
        if wrong.any():
            self.shapedirs[:, 0, wrong] *= -1
            warnings.warn(
                f"{printable(str(path))}: {int(wrong.sum())} of its {len(wrong)} shape directions have the right "
                "hand's sign in x, as in the published MANO_LEFT; they are mirrored here.",
                stacklevel=3,
            )

    @classmethod
    def open(cls, side: str = "right", dtype: torch.dtype = torch.float32) -> HandModel:
        """The open stand-in shipped with the package (CC0, from MakeHuman); `side` is right or left."""
        return cls(OPEN_HANDS / f"MANO_{side.upper()}.npz", dtype)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of all that gives a pose its meaning: template, joints, their parents, weights, pose correctives.

        The same for the same model in `.npz` or `.pkl`, in either precision and on any device.
        """
        values = [self.v_template, self.J_regressor, self.weights]
        values += [self.posedirs] if self.has_pose_correctives else []
        return sha256(*(value.float().cpu().numpy() for value in values), np.array(self.parents, np.int64))

    def is_named_by(self, recorded: str | None) -> bool:
        """Whether a recorded hash is of this hand: its fingerprint or, in old records, that of its template."""
        return recorded in (self.fingerprint, sha256(self.v_template.cpu().numpy()))

    def shaped(self, betas: Tensor, v_template: Tensor | None = None) -> Tensor:
        """Rest vertices (..., V, 3) of shapes `betas` (..., n) with n up to the model's number of betas."""
        n = betas.shape[-1]
        if n > self.shapedirs.shape[-1]:
            raise ValueError(f"{n} betas given, but this hand model has {self.shapedirs.shape[-1]}")
        return (self.v_template if v_template is None else v_template) + blended(self.shapedirs[..., :n], betas)

    def pose_from_pca(self, components: Tensor, flat_hand_mean: bool = True) -> Tensor:
        """(..., n) principal components → (..., 45) axis-angle; added to the mean pose unless `flat_hand_mean`."""
        pose = components @ self.hands_components[: components.shape[-1]]
        return pose if flat_hand_mean else pose + self.hands_mean

    def moved(
        self,
        parameters: HandParameters,
        rotation: Tensor,
        translation: Tensor | None = None,
        rest: Tensor | None = None,
    ) -> HandParameters:
        """The same hands after a rigid motion x → rotation x + translation of all they are made of.

        Not simply rotated parameters: transl is added after turning about the wrist, whose rest position moves along.

        Args:
            rotation, translation: (B or 1, 3, 3) and (B or 1, 3); no translation when omitted.
            rest: as in `forward`.
        """
        rest = self.v_template if rest is None else rest
        wrist = self.J_regressor[0] @ rest  # (3,) or (B, 3)
        turned = (rotation @ (wrist + parameters.transl).unsqueeze(-1)).squeeze(-1) - wrist
        transl = turned if translation is None else turned + translation
        return HandParameters(rotation @ parameters.global_orient, parameters.hand_pose, transl)

    def forward(self, parameters: HandParameters, rest: Tensor | None = None) -> Hand:
        """Pose the hand.

        Args:
            parameters: a batch of B poses.
            rest: rest vertices, (V, 3) shared or (B, V, 3): `shaped(betas)` or a subject's v_template; the model's
                own template when omitted.
        """
        return Hand(*self.pose(parameters.rotations, parameters.transl, self.v_template if rest is None else rest))
