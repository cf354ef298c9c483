"""Sampling a mesh's signed distance on a lattice, exactly where it matters and by interpolation where it is smooth.

An exact query at each of two million nodes takes ten seconds. But distance is 1-Lipschitz, and smooth away from the
surface and the medial axis. So a sparse lattice is sampled exactly and halved again and again; of the new nodes only
those that may lie near the surface, or where the prediction from their neighbours is in doubt, are sampled exactly.
"""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.geometry.queries import MeshQuery


def sample(
    query: MeshQuery,
    origin: Tensor,
    spacing: float,
    dims: tuple[int, int, int],
    stride: int,
    zone: float,
    doubt: float,
) -> Tensor:
    """Signed distance at the nodes of a lattice.

    Args:
        origin: (3,) position of the first node.
        dims: nodes along x, y, z, each 1 more than a multiple of `stride`.
        stride: of the first, exact lattice, a power of 2.
        zone: nodes closer than this to the surface are all exact; at least one spacing's diagonal.
        doubt: elsewhere a node is interpolated if linear and cubic prediction differ by less than this share of its
            distance.

    Returns:
        (nx, ny, nz) float32 distances, negative inside.
    """
    sparse = [(n - 1) // stride + 1 for n in dims]
    distance = query.signed_distance(_nodes(origin, spacing * stride, sparse)).view(sparse)
    while stride > 1:
        stride //= 2
        distance = _halved(query, distance, origin, spacing * stride, zone, doubt)
    return distance


def _halved(query: MeshQuery, coarse: Tensor, origin: Tensor, spacing: float, zone: float, doubt: float) -> Tensor:
    """The lattice of half the step, `spacing`, given the values at every other node of it."""
    unsigned = _upsampled(coarse.abs(), _linear)
    signed = _upsampled(coarse, _linear)
    smooth = _upsampled(coarse, _cubic)
    # No node is further from all of its parents than the half-diagonal of their cell.
    reach = spacing * 3**0.5
    wanted = (unsigned - reach < zone) | ((smooth - signed).abs() > doubt * unsigned)
    wanted[::2, ::2, ::2] = False  # the parents are exact, or settled
    index = wanted.flatten().nonzero().squeeze(1)

    distance = smooth.flatten()
    points = _positions(index, origin, spacing, signed.shape)
    exact = query.closest(points).distance
    # Where the surface is further than all parents, they lie on the node's own side.
    side = torch.where(exact > reach, signed.flatten()[index].sign(), 0)
    distance[index] = exact * side
    unsettled = _adopt_sides(distance, index[side == 0], exact[side == 0], spacing, signed.shape)
    points = _positions(unsettled, origin, spacing, signed.shape)
    distance[unsettled] = query.signed_distance(points)
    return distance.view(signed.shape)


def _adopt_sides(distance: Tensor, index: Tensor, exact: Tensor, spacing: float, dims: torch.Size) -> Tensor:
    """Give nodes of unknown side that of a neighbour, where no surface can lie between; returns the index of the rest.

    `distance` is changed in place; 0 in it means that the side is not known.
    """
    strides = (dims[1] * dims[2], dims[2], 1)
    for step in [sign * stride for stride in strides for sign in (1, -1)]:
        neighbour = distance[(index + step).clamp(0, len(distance) - 1)]
        same = torch.maximum(exact, neighbour.abs()) > spacing
        distance[index] = torch.where(same, neighbour.sign() * exact, 0)
        left = distance[index] == 0
        index, exact = index[left], exact[left]
    return index


def _nodes(origin: Tensor, spacing: float, dims: list[int]) -> Tensor:
    axes = [o + spacing * torch.arange(n, device=origin.device) for o, n in zip(origin, dims, strict=True)]
    return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).view(-1, 3)


def _positions(index: Tensor, origin: Tensor, spacing: float, dims: torch.Size) -> Tensor:
    return origin + spacing * torch.stack(torch.unravel_index(index, dims), -1)


def _upsampled(x: Tensor, middle) -> Tensor:
    """(nx, ny, nz) → (2nx-1, 2ny-1, 2nz-1): the nodes between are filled in along each axis by `middle`."""
    for axis in range(3):
        x = x.movedim(axis, 0)
        out = x.new_empty(2 * x.shape[0] - 1, *x.shape[1:])
        out[::2], out[1::2] = x, middle(x)
        x = out.movedim(0, axis)
    return x.contiguous()


def _linear(x: Tensor) -> Tensor:
    return (x[:-1] + x[1:]) / 2


def _cubic(x: Tensor) -> Tensor:
    """Midpoints by the cubic through the four nearest nodes; parabolas at both ends."""
    if len(x) < 4:
        return _linear(x)
    inner = (9 * (x[1:-2] + x[2:-1]) - x[:-3] - x[3:]) / 16
    return torch.cat([(3 * x[:1] + 6 * x[1:2] - x[2:3]) / 8, inner, (3 * x[-1:] + 6 * x[-2:-1] - x[-3:-2]) / 8])
