"""Linear blend skinning as matrix products, for any kinematic tree (hand: 16 joints, whole body: 55)."""

from __future__ import annotations

import torch
from torch import Tensor


def tree_levels(parents: list[int]) -> list[list[int]]:
    """Joints grouped by depth, root first, so that each level's transforms follow from the one before at once."""
    depth: list[int] = []
    for joint, parent in enumerate(parents):
        if parent >= joint:
            raise ValueError(f"joint {joint} has parent {parent}: parents must come before their children")
        depth.append(0 if parent < 0 else depth[parent] + 1)
    return [[j for j, d in enumerate(depth) if d == level] for level in range(max(depth) + 1)]


def forward_kinematics(
    rotations: Tensor, joints: Tensor, parents: list[int], levels: list[list[int]]
) -> tuple[Tensor, Tensor]:
    """World rotation and position of every joint.

    Args:
        rotations: (B, J, 3, 3) of each joint relative to its parent.
        joints: (B or 1, J, 3) rest positions, metres.
        parents: parent of each joint, -1 for the root.
        levels: `tree_levels(parents)`.

    Returns:
        rotations (B, J, 3, 3) and positions (B, J, 3). The root stays at its rest position.
    """
    batch = len(rotations)
    # Taken apart and put together as wholes: the gradient of indexing is a full tensor for every joint, and on a GPU
    # lists of indices are waited for.
    local, rest = rotations.unbind(1), joints.unbind(1)
    world: list[Tensor | None] = [None] * len(parents)
    position: list[Tensor | None] = [None] * len(parents)
    for joint in levels[0]:
        world[joint], position[joint] = local[joint], rest[joint].expand(batch, 3)
    for level in levels[1:]:
        above = [parents[j] for j in level]
        parent_rotation = torch.stack([world[p] for p in above], 1)
        offset = torch.stack([rest[j] - rest[p] for j, p in zip(level, above, strict=True)], 1).unsqueeze(-1)
        at = torch.stack([position[p] for p in above], 1) + (parent_rotation @ offset).squeeze(-1)
        turned = parent_rotation @ torch.stack([local[j] for j in level], 1)
        for joint, rotation, place in zip(level, turned.unbind(1), at.unbind(1), strict=True):
            world[joint], position[joint] = rotation, place
    return torch.stack(world, 1), torch.stack(position, 1)


def skin(vertices: Tensor, weights: Tensor, rotations: Tensor, translations: Tensor) -> Tensor:
    """Blend the joints' rigid motions at each vertex.

    With one rest shape for the whole batch this is a single product with the fixed matrix of weighted homogeneous
    vertices; with a shape per element the blended transforms are formed first (twice the work).

    Args:
        vertices: (V, 3) shared or (B, V, 3) rest vertices, metres.
        weights: (V, J) skinning weights, rows summing to 1.
        rotations, translations: (B, J, 3, 3) and (B, J, 3), rest to posed.

    Returns:
        (B, V, 3) posed vertices.
    """
    batch, n_joints = rotations.shape[:2]
    if vertices.dim() == 2:
        transforms = torch.cat([rotations, translations.unsqueeze(-1)], -1)  # (B, J, 3, 4)
        basis = (weights.unsqueeze(-1) * homogeneous(vertices).unsqueeze(1)).flatten(1)  # (V, J·4)
        posed = basis @ transforms.permute(1, 3, 0, 2).reshape(4 * n_joints, batch * 3)
        return posed.unflatten(1, (batch, 3)).transpose(0, 1)
    # Column by column of the transforms, so that no product of all columns with the vertices is ever stored.
    *columns, posed = (
        (column.mT.reshape(3 * batch, n_joints) @ weights.mT).unflatten(0, (batch, 3))  # (B, 3, V)
        for column in (*rotations.unbind(-1), translations)
    )
    for column, coordinate in zip(columns, vertices.unbind(-1), strict=True):
        posed = torch.addcmul(posed, column, coordinate.unsqueeze(1))
    return posed.mT.contiguous()


def homogeneous(points: Tensor) -> Tensor:
    """(..., 3) → (..., 4) with a one appended."""
    return torch.cat([points, torch.ones_like(points[..., :1])], -1)
