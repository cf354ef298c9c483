"""The edge loss's gradient, for all hands of a batch at once: sixteen and more together on a CPU."""

import warp as wp

import grabnet.geometry.kernels.launch  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})

_ADD_SIGNS = """
    const float *from = start.data, *to = end.data;
    float* sum = total.data;
    #if defined(__clang__)
    #pragma clang loop vectorize(assume_safety) vectorize_width(16)
    #endif
    for (int k = lane; k < total.shape[0]; k += lanes)
        sum[k] += (from[k] > to[k] ? 1.0f : 0.0f) - (from[k] < to[k] ? 1.0f : 0.0f);
"""


@wp.func_native(_ADD_SIGNS)
def add_signs(
    lane: int, lanes: int, start: wp.array(dtype=float), end: wp.array(dtype=float), total: wp.array(dtype=float)
):
    """Adds sign(start - end) to total."""


@wp.kernel
def edge_signs(
    lanes: int,
    neighbours: wp.array(dtype=int),
    neighbours_start: wp.array(dtype=int),
    difference: wp.array3d(dtype=float),
    vertex: wp.array(dtype=int),
    total: wp.array3d(dtype=float),
):
    """Sum over a vertex's neighbours n of sign(difference[vertex] - difference[n]); all are (V, 3, B), total zero."""
    item, lane = wp.tid()
    v = vertex[item]
    for k in range(neighbours_start[v], neighbours_start[v + 1]):
        n = neighbours[k]
        for axis in range(3):
            add_signs(lane, lanes, difference[v, axis], difference[n, axis], total[item, axis])
