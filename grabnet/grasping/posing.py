"""Pose points of a hand, with the gradient by torques about its joints instead of back through every transform."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.skinning import forward_kinematics, tree_levels


class HandChain:
    """The joints of one hand shape, and how anatomical angles turn them.

    Args:
        anatomy: of the hand model.
        joints: (J, 3) rest positions, metres.
        parents: parent of each joint, -1 for the wrist.
    """

    def __init__(self, anatomy: Anatomy, joints: Tensor, parents: list[int]):
        self.anatomy, self.joints, self.parents = anatomy, joints, parents
        self._levels = tree_levels(parents)
        moved = torch.eye(len(parents), dtype=joints.dtype)
        for joint, parent in enumerate(parents[1:], 1):
            moved[:, joint] += moved[:, parent]
        self.moved_by = moved.to(joints.device)  # (J, J): 1 where the row's joint moves the column's
        # An angle turns about its axis as the other angles of its joint leave it: the first turn of a joint moves with
        # the joint, the last with its parent, the thumb's flexion in between (see `Anatomy.hand_pose`).
        names = anatomy.angle_names
        self.thumb_flexion, self.thumb_abduction = names.index("thumb_cmc_flexion"), names.index("thumb_cmc_abduction")
        with_parent = torch.tensor(["abduction" in name for name in names], device=joints.device)
        with_parent[self.thumb_flexion] = True
        parent = torch.tensor(parents, device=joints.device)[anatomy.angle_joints]
        self._carrier = torch.where(with_parent, parent, anatomy.angle_joints)

    def transforms(self, rotation: Tensor, wrist: Tensor, angles: Tensor) -> tuple[Tensor, Tensor]:
        """(B, J, 3, 4) rest to posed, and joint positions (B, J, 3), of wrists (B, 3, 3), (B, 3), angles (B, 21)."""
        local = torch.cat([rotation.unsqueeze(1), self.anatomy.hand_pose(angles)], 1)
        world, position = forward_kinematics(local, self.joints.unsqueeze(0), self.parents, self._levels)
        position = position + (wrist - self.joints[0]).unsqueeze(1)
        offset = position - (world @ self.joints.unsqueeze(-1)).squeeze(-1)
        return torch.cat([world, offset.unsqueeze(-1)], -1), position

    def axes(self, world: Tensor, angles: Tensor) -> Tensor:
        """(B, 21, 3) axes about which the angles turn the posed hand, of joint rotations (B, J, 3, 3)."""
        axes = self.anatomy.angle_axes
        flexion, about = axes[self.thumb_flexion], axes[self.thumb_abduction]
        turn = angles[:, self.thumb_abduction, None]
        along = (flexion @ about) * about
        turned = along + turn.cos() * (flexion - along) + turn.sin() * torch.linalg.cross(about, flexion)
        local = axes.repeat(len(angles), 1, 1)
        local[:, self.thumb_flexion] = turned
        return (world[:, self._carrier] @ local.unsqueeze(-1)).squeeze(-1)


class PosePoints(torch.autograd.Function):
    """Points and directions that move with a hand.

    forward(rotation (B, 3, 3), wrist (B, 3), angles (B, 21), chain, basis (M, J·4)) → (B, M, 3): of each row of the
    basis the sum of what the joints' transforms make of it, `skinning_basis`.
    """

    @staticmethod
    def forward(ctx, rotation: Tensor, wrist: Tensor, angles: Tensor, chain: HandChain, basis: Tensor) -> Tensor:
        transforms, position = chain.transforms(rotation, wrist, angles)
        columns = transforms.permute(1, 3, 0, 2).contiguous()  # (J, 4, B, 3)
        ctx.save_for_backward(rotation, wrist, angles, transforms, columns, position, basis)
        ctx.chain = chain
        posed = basis @ columns.flatten(2).flatten(0, 1)
        return posed.unflatten(1, (len(wrist), 3)).transpose(0, 1).contiguous()

    @staticmethod
    def backward(ctx, pull: Tensor) -> tuple[Tensor, Tensor, Tensor, None, None]:
        rotation, wrist, angles, transforms, columns, position, basis = ctx.saved_tensors
        chain = ctx.chain
        by_column = (basis.mT @ pull.transpose(0, 1).flatten(1)).view(columns.shape)  # of each joint's own transform
        torque = torch.linalg.cross(columns, by_column).sum(1)  # (J, B, 3), about the origin
        both = torch.stack([torque, by_column[:, 3]])  # a joint bears those of all joints that it moves
        torque, force = (chain.moved_by @ both.flatten(2)).view(both.shape).transpose(1, 2)
        torque = torque - torch.linalg.cross(position, force)
        axes = chain.axes(transforms[..., :3], angles)
        turns = (axes * torque[:, chain.anatomy.angle_joints]).sum(-1)
        # Of a rotation's nine numbers, each as if it were free: points are rotation @ rest + wrist.
        arms = columns.clone()
        arms[:, 3] -= wrist
        spread = by_column.permute(2, 3, 0, 1).flatten(2) @ arms.permute(2, 0, 1, 3).flatten(1, 2)
        return spread @ rotation, force[:, 0], turns, None, None


def skinning_basis(points: Tensor, weights: Tensor) -> Tensor:
    """(M, J·4) rows of `PosePoints` for rest points in homogeneous coordinates (M, 4): 1 for points, 0 for directions.

    Args:
        weights: (M, J) skinning weights.
    """
    return (weights.unsqueeze(-1) * points.unsqueeze(1)).flatten(1)
