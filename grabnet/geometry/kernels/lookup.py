"""Table lookup for the SDF atlas.

A thread takes one row of points after the other, each row all around one object: what it reads of the table stays in
the cache, and where the table lies is looked up once. The loop over a row is C++ without branches, since warp's own
cannot know that points do not depend on each other: on a CPU sixteen points are looked up at once.
"""

import warp as wp

import grabnet.geometry.kernels.launch  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.struct
class Lattices:
    """All lattices of an atlas: 2 i is the fine one of object i, 2 i + 1 its coarse one."""

    fine_box: wp.array2d(dtype=wp.vec3)  # lowest and highest corner of each object's fine lattice
    origin: wp.array(dtype=wp.vec3)
    spacing: wp.array(dtype=float)
    dims: wp.array(dtype=wp.vec3i)
    offset: wp.array(dtype=int)  # of the lattice's first node in values
    values: wp.array(dtype=wp.float16)


@wp.struct
class Lattice:
    origin: wp.vec3
    per_metre: float  # nodes
    dims: wp.vec3i
    offset: int


@wp.func
def lattice(atlas: Lattices, level: int) -> Lattice:
    found = Lattice()
    found.origin = atlas.origin[level]
    found.per_metre = 1.0 / atlas.spacing[level]
    found.dims = atlas.dims[level]
    found.offset = atlas.offset[level]
    return found


# All in scalars, each then a register of sixteen points: structures keep clang from that. (The arrays do not overlap.)
_READ_ROW = """
    const auto half = [](unsigned short bits) {
        wp::half value;
        value.u = bits;
        return wp::half_to_float(value);
    };
    #if defined(__clang__)
    #pragma clang loop vectorize(assume_safety) vectorize_width(16)
    #endif
    for (int k = lane; k < points.shape[0]; k += lanes) {
        // In the object's frame.
        const wp::vec3 given = points.data[k];
        const float px =
            given[0] * turn.data[0][0] + given[1] * turn.data[1][0] + given[2] * turn.data[2][0] + centre[0];
        const float py =
            given[0] * turn.data[0][1] + given[1] * turn.data[1][1] + given[2] * turn.data[2][1] + centre[1];
        const float pz =
            given[0] * turn.data[0][2] + given[1] * turn.data[1][2] + given[2] * turn.data[2][2] + centre[2];

        // In nodes of the fine lattice where the point lies in its box, else of the coarse one.
        const bool near = (px > low[0]) & (py > low[1]) & (pz > low[2])
            & (px < high[0]) & (py < high[1]) & (pz < high[2]);
        const float per_metre = near ? fine.per_metre : coarse.per_metre;
        const float ux = (px - (near ? fine.origin[0] : coarse.origin[0])) * per_metre;
        const float uy = (py - (near ? fine.origin[1] : coarse.origin[1])) * per_metre;
        const float uz = (pz - (near ? fine.origin[2] : coarse.origin[2])) * per_metre;
        const int nx = near ? fine.dims[0] : coarse.dims[0];
        const int ny = near ? fine.dims[1] : coarse.dims[1];
        const int nz = near ? fine.dims[2] : coarse.dims[2];

        // Beyond the lattice: drawn towards its centre until on the border; the nearest surface hardly changes so.
        const float cx = 0.5f * (nx - 1), cy = 0.5f * (ny - 1), cz = 0.5f * (nz - 1);
        const float rx = fabsf(ux - cx) * (near ? 2.0f / (fine.dims[0] - 1) : 2.0f / (coarse.dims[0] - 1));
        const float ry = fabsf(uy - cy) * (near ? 2.0f / (fine.dims[1] - 1) : 2.0f / (coarse.dims[1] - 1));
        const float rz = fabsf(uz - cz) * (near ? 2.0f / (fine.dims[2] - 1) : 2.0f / (coarse.dims[2] - 1));
        const float further = rx > ry ? rx : ry, furthest = rz > further ? rz : further;
        const bool outside = furthest > 1.0f;
        const float draw = outside ? 1.0f / furthest : 1.0f;
        const float ix = outside ? cx + (ux - cx) * draw : ux;
        const float iy = outside ? cy + (uy - cy) * draw : uy;
        const float iz = outside ? cz + (uz - cz) * draw : uz;

        // Its cell; clamped, so that even NaN reads within the table.
        const int x = wp::max(wp::min((int)ix, nx - 2), 0);
        const int y = wp::max(wp::min((int)iy, ny - 2), 0);
        const int z = wp::max(wp::min((int)iz, nz - 2), 0);
        const float fx = ix - x, fy = iy - y, fz = iz - z;

        // Two nodes that follow each other along z are one read.
        const int n00 = (near ? fine.offset : coarse.offset) + (x * ny + y) * nz + z, n10 = n00 + ny * nz;
        unsigned int pair00, pair01, pair10, pair11;
        memcpy(&pair00, values.data + n00, 4);
        memcpy(&pair01, values.data + n00 + nz, 4);
        memcpy(&pair10, values.data + n10, 4);
        memcpy(&pair11, values.data + n10 + nz, 4);
        const float a00 = half(pair00), z00 = half(pair00 >> 16) - a00, v00 = a00 + z00 * fz;
        const float a01 = half(pair01), z01 = half(pair01 >> 16) - a01, v01 = a01 + z01 * fz;
        const float a10 = half(pair10), z10 = half(pair10 >> 16) - a10, v10 = a10 + z10 * fz;
        const float a11 = half(pair11), z11 = half(pair11 >> 16) - a11, v11 = a11 + z11 * fz;

        // Trilinear value and its gradient.
        const float y0 = v01 - v00, v0 = v00 + y0 * fy, z0 = z00 + (z01 - z00) * fy;
        const float y1 = v11 - v10, v1 = v10 + y1 * fy, z1 = z10 + (z11 - z10) * fy;
        const float value = v0 + (v1 - v0) * fx;
        const float sx = (v1 - v0) * per_metre;
        const float sy = (y0 + (y1 - y0) * fx) * per_metre;
        const float sz = (z0 + (z1 - z0) * fx) * per_metre;

        // From where the point leaves the lattice the surface lies `value` back along the slope. (NaN stays NaN.)
        const float metre = near ? 1.0f / fine.per_metre : 1.0f / coarse.per_metre;
        const float steepness = sqrtf(sx * sx + sy * sy + sz * sz);
        const float back = value / (steepness > 0.0f ? steepness : 1.0f);
        const float lx = (ux - ix) * metre + back * sx;
        const float ly = (uy - iy) * metre + back * sy;
        const float lz = (uz - iz) * metre + back * sz;
        const float leap = sqrtf(lx * lx + ly * ly + lz * lz), per_leap = 1.0f / leap;
        const float found = outside ? leap : value;
        distance.data[k] = positive ? fabsf(found) : found;
        if (want_gradient) {
            const float gx = outside ? lx * per_leap : sx;
            const float gy = outside ? ly * per_leap : sy;
            const float gz = outside ? lz * per_leap : sz;
            wp::vec3& gradient_k = gradient.data[k];
            gradient_k[0] = gx * turn.data[0][0] + gy * turn.data[0][1] + gz * turn.data[0][2];
            gradient_k[1] = gx * turn.data[1][0] + gy * turn.data[1][1] + gz * turn.data[1][2];
            gradient_k[2] = gx * turn.data[2][0] + gy * turn.data[2][1] + gz * turn.data[2][2];
        }
    }
"""


@wp.func_native(_READ_ROW)
def read_row(
    lane: int,
    lanes: int,
    values: wp.array(dtype=wp.float16),
    fine: Lattice,
    coarse: Lattice,
    low: wp.vec3,
    high: wp.vec3,
    turn: wp.mat33,
    centre: wp.vec3,
    points: wp.array(dtype=wp.vec3),
    positive: bool,
    want_gradient: bool,
    distance: wp.array(dtype=float),
    gradient: wp.array(dtype=wp.vec3),
):
    """Signed distances, or if `positive` unsigned ones, of points to one object, and their gradient.

    Read from the fine lattice where a point lies between low and high, else from the coarse one.
    """


@wp.kernel
def signed_distances(
    lanes: int,
    atlas: Lattices,
    objects: wp.array(dtype=int),
    rotations: wp.array(dtype=wp.mat33),
    centres: wp.array(dtype=wp.vec3),
    points: wp.array2d(dtype=wp.vec3),
    want_gradient: bool,
    distance: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=wp.vec3),
    rows: wp.array(dtype=int),
):
    """Signed distance to `objects`, one for each row, turned about their `centres`, which lie at the origin."""
    thread, lane = wp.tid()
    row = rows[thread]
    item = objects[row]
    read_row(
        lane,
        lanes,
        atlas.values,
        lattice(atlas, 2 * item),
        lattice(atlas, 2 * item + 1),
        atlas.fine_box[item, 0],
        atlas.fine_box[item, 1],
        rotations[row],
        centres[row],
        points[row],
        False,
        want_gradient,
        distance[row],
        gradient[row],
    )


@wp.kernel
def basis_distances(
    lanes: int,
    atlas: Lattices,
    objects: wp.array(dtype=int),
    rotations: wp.array(dtype=wp.mat33),
    centres: wp.array(dtype=wp.vec3),
    basis: wp.array(dtype=wp.vec3),
    distance: wp.array2d(dtype=float),
    rows: wp.array(dtype=int),
):
    """Distance of the points of one basis to objects turned about their `centres`, which lie at its origin.

    All from the coarse lattice, which stays in the cache: hundredths of a millimetre off, in half the time.
    """
    thread, lane = wp.tid()
    row = rows[thread]
    coarse = lattice(atlas, 2 * objects[row] + 1)
    nowhere = wp.vec3(0.0)
    read_row(
        lane,
        lanes,
        atlas.values,
        coarse,
        coarse,
        nowhere,
        nowhere,
        rotations[row],
        centres[row],
        basis,
        True,
        False,
        distance[row],
        basis,
    )
