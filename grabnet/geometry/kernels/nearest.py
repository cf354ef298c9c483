"""Nearest vertex of a deformed mesh, and the side of the surface that a point lies on.

Every vertex is compared, sixteen and more at once on a CPU: for a hand's 778 that is several times faster than any tree
or bound that would spare some of them.
"""

import warp as wp

import grabnet.geometry.kernels.launch  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.struct
class Topology:
    """What all poses of a mesh share."""

    opposite: wp.array(dtype=wp.vec2i)  # the two other corners of each face at each vertex, vertex after vertex
    start: wp.array(dtype=int)  # of each vertex therein, and the end


# Distance and number in one integer, of which the smallest is sought: squares are not negative, and the bits of such
# floats are in the order of their values.
_NEAREST = """
    const float *xs = x.data, *ys = y.data, *zs = z.data;
    const float px = p[0], py = p[1], pz = p[2];
    long long best = 0x7fffffffffffffffLL;
    #if defined(__clang__)
    #pragma clang loop vectorize(assume_safety) vectorize_width(8) interleave_count(4)
    #endif
    for (int k = 0; k < x.shape[0]; ++k) {
        const float dx = xs[k] - px, dy = ys[k] - py, dz = zs[k] - pz;
        const float square = dx * dx + dy * dy + dz * dz;
        unsigned int bits;
        memcpy(&bits, &square, 4);
        best = wp::min(best, ((long long)bits << 32) | k);
    }
    return (int)best;
"""


@wp.func_native(_NEAREST)
def nearest(x: wp.array(dtype=float), y: wp.array(dtype=float), z: wp.array(dtype=float), p: wp.vec3) -> int:
    """Number of the point (x, y, z) nearest to p; of equal ones the first."""


@wp.kernel
def nearest_vertex(
    lanes: int,
    topology: Topology,
    vertices: wp.array2d(dtype=wp.vec3),
    coordinates: wp.array3d(dtype=float),
    queries: wp.array2d(dtype=wp.vec3),
    index: wp.array2d(dtype=int),
    behind: wp.array2d(dtype=wp.bool),
):
    """Index of the vertex nearest to each query, and whether the query lies behind the surface there.

    `coordinates` are those of the vertices, (B, 3, V).
    """
    row, lane = wp.tid()
    x = coordinates[row, 0]
    y = coordinates[row, 1]
    z = coordinates[row, 2]
    for q in range(lane, queries.shape[1], lanes):
        p = queries[row, q]
        best = nearest(x, y, z, p)
        index[row, q] = best

        vertex = vertices[row, best]
        normal = wp.vec3(0.0)
        for k in range(topology.start[best], topology.start[best + 1]):
            others = topology.opposite[k]
            normal += wp.cross(vertices[row, others[0]] - vertex, vertices[row, others[1]] - vertex)
        behind[row, q] = wp.dot(p - vertex, normal) < 0.0
