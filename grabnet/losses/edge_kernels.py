"""The edge loss in one pass over each hand."""

import warp as wp

import grabnet.geometry.warping  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.func
def sign(x: float) -> float:
    return wp.where(x > 0.0, 1.0, wp.where(x < 0.0, -1.0, 0.0))


@wp.kernel
def edge_l1(
    lanes: int,
    start: wp.array(dtype=int),
    neighbours: wp.array(dtype=int),
    difference: wp.array2d(dtype=wp.vec3),
    total: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """Σ |Δ edge| over the edges that start at each vertex, either way of each, and the sum's gradient by |Δ|'s."""
    row, lane = wp.tid()
    for v in range(lane, difference.shape[1], lanes):
        d = difference[row, v]
        length = wp.float32(0.0)
        slope = wp.vec3(0.0)
        for k in range(start[v], start[v + 1]):
            edge = d - difference[row, neighbours[k]]
            length += wp.abs(edge[0]) + wp.abs(edge[1]) + wp.abs(edge[2])
            slope += wp.vec3(sign(edge[0]), sign(edge[1]), sign(edge[2]))
        total[row, v] = length
        gradient[row, v] = slope
