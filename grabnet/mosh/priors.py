"""What a body does without markers to say otherwise: a Gaussian for each joint, along its anatomical axes.

Nothing is learned from recordings, so the same prior serves every model and every data set. Hands may keep to the
principal components of their model instead, which were learned. All angles are radians.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.skeleton import JOINTS, LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS
from grabnet.body.whole import BodyModel
from grabnet.cli.checks import Positive, Range, Weight, in_range
from grabnet.errors import UserError

# Mean and spread of joints by x, y, z of the resting body (left, up, ahead); of a left joint, mirrored for the right.
# Arms hang rather than spread, elbows and knees are hinges, slightly bent.
_JOINTS = {
    "spine1": ((0.05, 0, 0), (0.25, 0.2, 0.2)),
    "spine2": ((0.05, 0, 0), (0.25, 0.2, 0.2)),
    "spine3": ((0.05, 0, 0), (0.2, 0.2, 0.2)),
    "neck": ((0.1, 0, 0), (0.3, 0.3, 0.2)),
    "head": ((0.1, 0, 0), (0.3, 0.3, 0.2)),
    "left_collar": ((0, 0, 0), (0.15, 0.15, 0.15)),
    "left_shoulder": ((0.1, 0, -0.9), (0.6, 0.6, 0.6)),
    "left_elbow": ((0, -0.6, 0), (0.4, 0.8, 0.25)),
    "left_wrist": ((0, 0, 0), (0.4, 0.3, 0.4)),
    "left_hip": ((-0.1, 0, 0), (0.6, 0.3, 0.3)),
    "left_knee": ((0.2, 0, 0), (0.7, 0.12, 0.12)),
    "left_ankle": ((0, 0, 0), (0.4, 0.2, 0.2)),
    "left_foot": ((0, 0, 0), (0.2, 0.05, 0.05)),
}
_JAW = ((0.1, 0, 0), (0.2, 0.06, 0.03))
_EYES = ((0, 0, 0), (0.2, 0.3, 0.02))


@dataclass(frozen=True)
class PriorConfig:
    """How strongly to hold to what is usual. Spreads are standard deviations.

    Attributes:
        body: factor on the spreads of the trunk's and limbs' joints.
        hands: factor on those of the fingers' joints.
        face: factor on those of jaw and eyes.
        flexion, abduction, twist: spread of a finger's joints about their axes, radians.
        flexed: their mean flexion, radians.
        hand_components: principal components that a hand's fingers keep to, in place of their joints' axes; 0: none.
        component: spread of a component's coefficient, radians.
        beside: spread of what the components leave out, radians.
        expression: spread of expression values.
        still: names of joints that are not solved for, and stay as they usually are.
        missing: how much the prior of a frame grows when all markers are missing, in proportion for fewer (ref. 5).

    Raises:
        UserError: a spread or factor that is not above 0.
    """

    body: Positive = 1.0
    hands: Positive = 1.0
    face: Positive = 1.0
    flexion: Positive = 0.5
    abduction: Positive = 0.15
    twist: Positive = 0.06
    flexed: Annotated[float, Range(-math.pi, math.pi)] = 0.35
    hand_components: Annotated[int, Range(0, 45)] = 0
    component: Positive = 0.6
    beside: Positive = 0.05
    expression: Positive = 1.0
    still: Sequence[str] = ("left_eye", "right_eye")
    missing: Weight = 2.5

    def __post_init__(self):
        in_range(self, "prior.")
        if unknown := [name for name in self.still if name not in JOINTS]:
            raise UserError(f"prior.still names {unknown[0]}; it can be {', '.join(JOINTS)}.")

    @property
    def fixed(self) -> tuple[int, ...]:
        """Numbers of the joints that are not solved for."""
        return tuple(JOINTS.index(name) for name in self.still)


class HandPrior(NamedTuple):
    """joints (15,) numbers of a hand's; mean (45,) of their rotation vectors; covariance (45, 45)."""

    joints: Tensor
    mean: Tensor
    covariance: Tensor


class JointPrior(NamedTuple):
    """mean (J, 3) rotation vectors; precision (J, 3, 3) inverse covariances, 0 of what is free, as the pelvis is; hands
    whose joints have a prior together."""

    mean: Tensor
    precision: Tensor
    hands: tuple[HandPrior, ...] = ()


def joint_prior(body: BodyModel, config: PriorConfig) -> JointPrior:
    """The prior of every joint of a body, float64."""
    mean, precision = torch.zeros(len(JOINTS), 3).double(), torch.zeros(len(JOINTS), 3, 3).double()
    mirror = torch.tensor([1.0, -1.0, -1.0]).double()
    for joint, name in enumerate(JOINTS):
        known, factor = _JOINTS.get(name.replace("right_", "left_")), config.body
        if name == "jaw" or name.endswith("_eye"):
            known, factor = (_JAW if name == "jaw" else _EYES), config.face
        if known is None:
            continue
        middle, spread = (torch.tensor(values).double() for values in known)
        mean[joint] = middle * mirror if name.startswith("right_") else middle
        precision[joint] = torch.diag((factor * spread) ** -2)
    for numbers, right in ((LEFT_HAND_JOINTS, False), (RIGHT_HAND_JOINTS, True)):
        hand = Anatomy.of(_HandOfBody(body, numbers, right))
        axes, joints = hand.angle_axes.double(), hand.angle_joints
        for local in range(1, len(numbers)):
            own = [axes[k] for k in (joints == local).nonzero().squeeze(1)]
            flexion = own[0]
            side = own[1] if len(own) > 1 else _across(flexion, body, numbers, local)
            third = torch.linalg.cross(flexion, side)
            sideways = config.abduction if len(own) > 1 else config.twist
            twist = config.abduction if len(own) > 2 else config.twist
            frame = torch.stack([flexion, side, third])
            spread = config.hands * torch.tensor([config.flexion, sideways, twist]).double()
            if len(own) > 2:  # the base of the thumb turns about all of its axes
                spread[:] = config.hands * torch.tensor([0.4, 0.3, 0.3]).double()
            mean[numbers[local]] = config.flexed * flexion * (0.5 if local > 12 else 1)
            precision[numbers[local]] = frame.T @ torch.diag(spread**-2) @ frame
    if not config.hand_components:
        return JointPrior(mean, precision)
    hands = tuple(
        _hand_prior(numbers, *parts, config)
        for numbers, parts in (
            (LEFT_HAND_JOINTS, (body.hands_meanl, body.hands_componentsl)),
            (RIGHT_HAND_JOINTS, (body.hands_meanr, body.hands_componentsr)),
        )
    )
    for hand in hands:
        precision[hand.joints] = 0
    return JointPrior(mean, precision, hands)


def _hand_prior(numbers: tuple[int, ...], mean: Tensor, components: Tensor, config: PriorConfig) -> HandPrior:
    """The prior of a hand's fingers by the first of its model's orthonormal components (45, 45)."""
    kept = components[: config.hand_components].double()
    along = kept.mT @ kept
    beside = torch.eye(len(along)).double() - along
    covariance = config.hands**2 * (config.component**2 * along + config.beside**2 * beside)
    return HandPrior(torch.tensor(numbers[1:]), mean.double(), covariance)


def _across(flexion: Tensor, body: BodyModel, numbers: tuple[int, ...], local: int) -> Tensor:
    """A unit vector perpendicular to flexion axis and bone: about it a finger would bend sideways."""
    joints = body.rest_joints(body.v_template).double()
    bone = joints[numbers[local]] - joints[numbers[local - 1]]
    side = torch.linalg.cross(bone, flexion)
    return side / side.norm()


class _HandOfBody:
    """One hand of a body, as far as its anatomy goes."""

    def __init__(self, body: BodyModel, numbers: tuple[int, ...], is_right: bool):
        self.v_template, self.faces, self.is_right = body.v_template, body.faces, is_right
        self.weights, self._body, self._numbers = body.weights[:, numbers], body, [*numbers]

    def rest_joints(self, vertices: Tensor) -> Tensor:
        return self._body.rest_joints(vertices)[self._numbers]
