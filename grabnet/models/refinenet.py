"""RefineNet: corrects a grasp step by step from the hand's distances to the object (paper 4, ref. 6)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from grabnet.body.hand import HandModel, HandParameters
from grabnet.errors import UserError
from grabnet.geometry.rotations import matrix_to_six_d, six_d_to_matrix
from grabnet.models.generator import SavedNetwork
from grabnet.models.layers import BatchNorm, Head, ResidualBlock, concatenate
from grabnet.models.published import CONVENTIONS, REFINENET, PublishedWeights

_MAX_ITERATIONS = 100


class RefineNet(SavedNetwork):
    """Three residual iterations with shared weights; the hand is posed and measured again between them.

    Args:
        hand: poses the estimate between iterations; it is not trained and not saved with the weights.
        iterations: number of corrections.
        width: features between the residual blocks.
        n_hidden: features inside a residual block.
        dropout: probability, after each block.
    """

    sees = ("centre", "distances")

    def __init__(
        self, hand: HandModel, iterations: int = 3, width: int = 512, n_hidden: int = 256, dropout: float = 0.3
    ):
        super().__init__()
        if iterations not in range(1, _MAX_ITERATIONS + 1):
            raise UserError(
                f"iterations is {iterations}; RefineNet needs at least 1 to correct anything, and {_MAX_ITERATIONS} at "
                "most."
            )
        self.hand = hand
        self.iterations = iterations
        n_vertices, n_joints = len(hand.v_template), len(hand.parents)
        n_in = n_vertices + n_joints * 6 + 3
        self.distance_norm = BatchNorm(n_vertices)
        self.block1 = ResidualBlock(n_in, width, n_hidden)
        self.block2 = ResidualBlock(n_in + width, width, n_hidden)
        self.block3 = ResidualBlock(n_in + width, width, n_hidden)
        self.dropout = nn.Dropout(dropout)
        self.pose = Head(width, n_joints * 6)
        self.transl = Head(width, 3)
        # Training starts from about no correction: a random one, made three times, would throw the hand off first.
        with torch.no_grad():
            for layer in (self.pose, self.transl):
                layer.weight.mul_(0.1)
                layer.bias.zero_()

    @classmethod
    def from_published(cls, path: str | Path, hand: HandModel) -> RefineNet:
        """The published network, in eval mode.

        Args:
            path: of `refinenet.pt`.
            hand: MANO's right hand, which the weights hold for; the copy in the file is not used.

        Raises:
            UserError: unreadable, or names or shapes that are not the published network's for this hand.
        """
        weights = PublishedWeights(path, REFINENET)
        network = cls(
            hand,
            width=weights.size("out_p.weight", 1, 512),
            n_hidden=weights.size("rb1.fc1.weight", 0, 256),
        )
        weights.fill(network)
        network.conventions = replace(CONVENTIONS, hand=hand.fingerprint)
        return network.eval()

    def arguments(self) -> dict[str, int | float]:
        return {
            "iterations": self.iterations,
            "width": self.block1.fc2.out_features,
            "n_hidden": self.block1.fc1.out_features,
            "dropout": self.dropout.p,
        }

    @classmethod
    def rebuild(
        cls, arguments: Mapping[str, int | float], tensors: Mapping[str, Tensor], hand: HandModel | None
    ) -> RefineNet:
        if hand is None:
            raise UserError("RefineNet needs the hand model it was trained with")
        n_vertices = len(tensors["distance_norm.weight"])
        if n_vertices != len(hand.v_template):
            raise UserError(f"it was trained for a hand of {n_vertices} vertices; this one has {len(hand.v_template)}")
        return cls(hand, **arguments)

    def correction(self, distances: Tensor, pose: Tensor, transl: Tensor) -> tuple[Tensor, Tensor]:
        """Changes of pose (B, 96) and transl (B, 3) for hand→object distances (B, V) in metres."""
        x = concatenate(self.distance_norm(distances), pose, transl)
        h = self.dropout(self.block1(x))
        h = self.dropout(self.block2(concatenate(h, x)))
        h = self.dropout(self.block3(concatenate(h, x)))
        return self.pose(h), self.transl(h)

    def forward(
        self, parameters: HandParameters, distances: Callable[[Tensor], Tensor], rest: Tensor | None = None
    ) -> HandParameters:
        """Refine a batch of grasps.

        Args:
            parameters: the estimate, in the object-centred world frame.
            distances: hand vertices (B, V, 3) in that frame → their distances to the object (B, V), metres.
            rest: rest vertices of the hands, as `HandModel.forward` takes them.
        """
        pose, transl = matrix_to_six_d(parameters.rotations).flatten(1), parameters.transl
        for _ in range(self.iterations):
            vertices = self.hand(parameters, rest).vertices
            pose_change, transl_change = self.correction(distances(vertices), pose, transl)
            pose, transl = pose + pose_change, transl + transl_change
            parameters = HandParameters.from_rotations(six_d_to_matrix(pose.unflatten(1, (-1, 6))), transl)
        return parameters
