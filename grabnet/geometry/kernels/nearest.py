"""Nearest points of a cloud, such as the vertices of a posed hand, and the side of the surface that a query lies on.

Sixteen queries are compared at once with one point after the other, the form that a CPU's vector units take. Points lie
in blocks: a block that is farther from each of the sixteen than the point found for it is left out. Where neighbours
follow each other, among the queries and among the points, that spares two thirds of the blocks.
"""

import warp as wp

import grabnet.geometry.kernels.launch  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})

# Queries compared at once; also in the native code below.
GROUP = wp.constant(16)


@wp.struct
class Topology:
    """What all poses of a mesh share."""

    opposite: wp.array(dtype=wp.vec2i)  # the two other corners of each face at each vertex, vertex after vertex
    start: wp.array(dtype=int)  # of each vertex therein, and the end
    order: wp.array(dtype=int)  # vertices, in the order in which they are searched


# It starts at the block whose centre is nearest to one of the queries: what it finds there rules out most others.
_NEAREST = """
    const int blocks = box.shape[1];
    const int size = x.shape[0] / blocks;
    const float *xs = x.data, *ys = y.data, *zs = z.data;
    const float *low_x = box.data, *low_y = low_x + blocks, *low_z = low_y + blocks;
    const float *high_x = low_z + blocks, *high_y = high_x + blocks, *high_z = high_y + blocks;
    const int count = wp::min(queries.shape[0] - start, 16);

    float px[16], py[16], pz[16], least[16];
    int place[16];
    for (int l = 0; l < 16; ++l) {
        const wp::vec3 p = queries.data[start + wp::min(l, count - 1)];
        px[l] = p[0];
        py[l] = p[1];
        pz[l] = p[2];
        least[l] = INFINITY;
        place[l] = 0;
    }

    int first = 0;
    float closest = INFINITY;
    for (int b = 0; b < blocks; ++b) {
        const float dx = 0.5f * (low_x[b] + high_x[b]) - px[0];
        const float dy = 0.5f * (low_y[b] + high_y[b]) - py[0];
        const float dz = 0.5f * (low_z[b] + high_z[b]) - pz[0];
        const float square = dx * dx + dy * dy + dz * dz;
        first = square < closest ? b : first;
        closest = square < closest ? square : closest;
    }

    for (int k = 0; k < blocks; ++k) {
        const int b = first + k < blocks ? first + k : first + k - blocks;
        int closer = 0;
        for (int l = 0; l < 16; ++l) {
            const float dx = wp::max(wp::max(low_x[b] - px[l], px[l] - high_x[b]), 0.0f);
            const float dy = wp::max(wp::max(low_y[b] - py[l], py[l] - high_y[b]), 0.0f);
            const float dz = wp::max(wp::max(low_z[b] - pz[l], pz[l] - high_z[b]), 0.0f);
            closer |= dx * dx + dy * dy + dz * dz < least[l];
        }
        if (!closer) continue;
        for (int i = b * size; i < (b + 1) * size; ++i) {
            for (int l = 0; l < 16; ++l) {
                const float dx = xs[i] - px[l], dy = ys[i] - py[l], dz = zs[i] - pz[l];
                const float square = dx * dx + dy * dy + dz * dz;
                place[l] = square < least[l] ? i : place[l];
                least[l] = square < least[l] ? square : least[l];
            }
        }
    }
    for (int l = 0; l < count; ++l) index.data[start + l] = place[l];
"""


@wp.func_native(_NEAREST)
def nearest(
    x: wp.array(dtype=float),
    y: wp.array(dtype=float),
    z: wp.array(dtype=float),
    box: wp.array2d(dtype=float),
    queries: wp.array(dtype=wp.vec3),
    start: int,
    index: wp.array(dtype=int),
):
    """Write the indices of the points (x, y, z) nearest to `GROUP` queries from `start` on.

    `box` (6, blocks) has the lowest and the highest corner around each block of points.
    """
    ...


@wp.kernel
def nearest_points(
    lanes: int,
    coordinates: wp.array3d(dtype=float),
    boxes: wp.array3d(dtype=float),
    queries: wp.array2d(dtype=wp.vec3),
    index: wp.array2d(dtype=int),
):
    """Index of the point nearest to each query. `coordinates` (B, 3, blocks × size); `boxes` (B, 6, blocks)."""
    row, lane = wp.tid()
    x = coordinates[row, 0]
    y = coordinates[row, 1]
    z = coordinates[row, 2]
    for start in range(GROUP * lane, queries.shape[1], GROUP * lanes):
        nearest(x, y, z, boxes[row], queries[row], start, index[row])


@wp.kernel
def vertex_normals(
    lanes: int, topology: Topology, vertices: wp.array2d(dtype=wp.vec3), normals: wp.array2d(dtype=wp.vec3)
):
    """Sum of the normals of the faces at each vertex, weighted by area; of any length."""
    row, lane = wp.tid()
    for v in range(lane, vertices.shape[1], lanes):
        vertex = vertices[row, v]
        normal = wp.vec3(0.0)
        for k in range(topology.start[v], topology.start[v + 1]):
            others = topology.opposite[k]
            normal += wp.cross(vertices[row, others[0]] - vertex, vertices[row, others[1]] - vertex)
        normals[row, v] = normal


@wp.kernel
def signed_distances(
    lanes: int,
    topology: Topology,
    vertices: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
    queries: wp.array2d(dtype=wp.vec3),
    index: wp.array2d(dtype=int),
    distance: wp.array2d(dtype=float),
):
    """Distance to the nearest vertex, negative where the query lies behind the surface there.

    `index` of that vertex: before, its place in `topology.order`; afterwards its number.
    """
    row, lane = wp.tid()
    for q in range(lane, queries.shape[1], lanes):
        vertex = topology.order[index[row, q]]
        index[row, q] = vertex
        offset = queries[row, q] - vertices[row, vertex]
        length = wp.sqrt(wp.dot(offset, offset) + 1.0e-12)  # a gradient at distance 0, too
        distance[row, q] = wp.where(wp.dot(offset, normals[row, vertex]) < 0.0, -length, length)


@wp.kernel
def distance_gradient(
    lanes: int,
    vertices: wp.array2d(dtype=wp.vec3),
    queries: wp.array2d(dtype=wp.vec3),
    index: wp.array2d(dtype=int),
    distance: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=float),
    vertex_gradient: wp.array2d(dtype=wp.vec3),
):
    """Turn a gradient by `signed_distances` into one by the vertices."""
    row, lane = wp.tid()
    for q in range(lane, queries.shape[1], lanes):
        vertex = index[row, q]
        offset = queries[row, q] - vertices[row, vertex]
        wp.atomic_sub(vertex_gradient, row, vertex, offset * (gradient[row, q] / distance[row, q]))
