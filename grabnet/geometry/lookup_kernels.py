"""Table lookup for the SDF atlas, in two kernels: where each point's cell lies, then what its corners hold.

Split so, because the corners lie scattered over hundreds of megabytes: the second kernel is short enough for a CPU to
have the corners of many points on their way at once, which halves the time.
"""

import warp as wp

import grabnet.geometry.warping  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.struct
class Levels:
    """Lattices of all objects: level 2 i is the fine one of object i, 2 i + 1 its coarse one."""

    fine_low: wp.array(dtype=wp.vec3)  # box of the fine level, per object
    fine_high: wp.array(dtype=wp.vec3)
    origin: wp.array(dtype=wp.vec3)  # per level
    spacing: wp.array(dtype=float)
    dims: wp.array(dtype=wp.vec3i)
    offset: wp.array(dtype=wp.int64)  # of the first node in the flat buffer


@wp.func
def within(p: wp.vec3, low: wp.vec3, high: wp.vec3):
    return (
        p[0] >= low[0] and p[1] >= low[1] and p[2] >= low[2] and p[0] <= high[0] and p[1] <= high[1] and p[2] <= high[2]
    )


@wp.kernel
def locate(
    levels: Levels,
    points: wp.array2d(dtype=wp.vec3),
    objects: wp.array(dtype=wp.int64),
    level: wp.array2d(dtype=int),
    node: wp.array2d(dtype=wp.int64),
    fraction: wp.array2d(dtype=wp.vec3),
    excess: wp.array2d(dtype=wp.vec3),
):
    """The cell of each point: its lowest node, the place in it (0 to 1), and by how much the point lies outside."""
    i, j = wp.tid()
    p = points[i, j]
    item = int(objects[i])
    k = 2 * item
    if not within(p, levels.fine_low[item], levels.fine_high[item]):
        k += 1
    dims = levels.dims[k]
    last = wp.vec3(float(dims[0] - 1), float(dims[1] - 1), float(dims[2] - 1))
    u = (p - levels.origin[k]) / levels.spacing[k]
    inside = wp.max(wp.min(u, last), wp.vec3(0.0))
    # Clamped as integers too, so that NaN reads within the buffer; the excess carries it on.
    x = wp.clamp(int(inside[0]), 0, dims[0] - 2)
    y = wp.clamp(int(inside[1]), 0, dims[1] - 2)
    z = wp.clamp(int(inside[2]), 0, dims[2] - 2)
    level[i, j] = k
    node[i, j] = levels.offset[k] + wp.int64((x * dims[1] + y) * dims[2] + z)
    fraction[i, j] = inside - wp.vec3(float(x), float(y), float(z))
    excess[i, j] = (u - inside) * levels.spacing[k]


@wp.kernel
def interpolate(
    values: wp.array(dtype=wp.float16),
    levels: Levels,
    want_gradient: bool,
    level: wp.array2d(dtype=int),
    node: wp.array2d(dtype=wp.int64),
    fraction: wp.array2d(dtype=wp.vec3),
    excess: wp.array2d(dtype=wp.vec3),
    distance: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """Trilinear value and its gradient; beyond the lattice those of the surface point seen from its border."""
    i, j = wp.tid()
    k = level[i, j]
    f = fraction[i, j]
    dims = levels.dims[k]
    row = wp.int64(dims[2])
    sheet = row * wp.int64(dims[1])
    a = node[i, j]
    b = a + row
    c = a + sheet
    d = c + row
    one = wp.int64(1)
    a0 = float(values[a])
    b0 = float(values[b])
    c0 = float(values[c])
    d0 = float(values[d])
    az = float(values[a + one]) - a0
    bz = float(values[b + one]) - b0
    cz = float(values[c + one]) - c0
    dz = float(values[d + one]) - d0
    a0 += az * f[2]
    b0 += bz * f[2]
    c0 += cz * f[2]
    d0 += dz * f[2]
    low = wp.lerp(a0, b0, f[1])
    high = wp.lerp(c0, d0, f[1])
    value = wp.lerp(low, high, f[0])
    slope = wp.vec3(
        high - low,
        wp.lerp(b0 - a0, d0 - c0, f[0]),
        wp.lerp(wp.lerp(az, bz, f[1]), wp.lerp(cz, dz, f[1]), f[0]),
    )
    slope = slope / levels.spacing[k]
    outside = excess[i, j]
    if outside[0] != 0.0 or outside[1] != 0.0 or outside[2] != 0.0:
        # From where the point leaves the lattice the surface lies `value` back along the slope.
        leap = outside + value * wp.normalize(slope)
        value = wp.length(leap)
        slope = leap / value
    distance[i, j] = value
    if want_gradient:
        gradient[i, j] = slope
