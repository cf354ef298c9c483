"""Table lookup for the SDF atlas, in two kernels: where each point's cell lies, then what its corners hold.

Split so, because the corners lie scattered over hundreds of megabytes: the second kernel is short enough for a CPU to
have the corners of many points on their way at once, which halves the time.
"""

import warp as wp

import grabnet.geometry.warping  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.kernel
def locate(
    fine_box: wp.array2d(dtype=wp.vec3),  # lowest and highest corner of each object's fine level
    origin: wp.array(dtype=wp.vec3),  # of level 2 i, the fine one of object i, and of 2 i + 1, its coarse one
    spacing: wp.array(dtype=float),
    dims: wp.array(dtype=wp.vec3i),
    offset: wp.array(dtype=int),
    points: wp.array(dtype=wp.vec3),
    objects: wp.array(dtype=int),
    cell: wp.array(dtype=wp.vec3i),
    place: wp.array(dtype=wp.vec4),
    excess: wp.array(dtype=wp.vec3),
):
    """For each point, its cell and how far it lies outside of the lattice.

    cell: index of the lowest corner, and the steps to the next node along x and along y. place: where in the cell the
    point lies, 0 to 1, and the cell's side.
    """
    i = wp.tid()
    p = points[i]
    item = objects[i]
    low = fine_box[item, 0]
    high = fine_box[item, 1]
    level = 2 * item
    if p[0] < low[0] or p[1] < low[1] or p[2] < low[2] or p[0] > high[0] or p[1] > high[1] or p[2] > high[2]:
        level += 1
    n = dims[level]
    u = (p - origin[level]) / spacing[level]
    # A point outside is drawn towards the centre, until on the border: the surface nearest to it hardly changes so.
    centre = 0.5 * wp.vec3(float(n[0] - 1), float(n[1] - 1), float(n[2] - 1))
    ratio = wp.abs(wp.cw_div(u - centre, centre))
    furthest = wp.max(wp.max(ratio[0], ratio[1]), ratio[2])
    inside = u
    if furthest > 1.0:
        inside = centre + (u - centre) / furthest
    # Clamped, so that even NaN reads within the buffer; the excess carries it on.
    x = wp.clamp(int(inside[0]), 0, n[0] - 2)
    y = wp.clamp(int(inside[1]), 0, n[1] - 2)
    z = wp.clamp(int(inside[2]), 0, n[2] - 2)
    cell[i] = wp.vec3i(offset[level] + (x * n[1] + y) * n[2] + z, n[1] * n[2], n[2])
    place[i] = wp.vec4(inside[0] - float(x), inside[1] - float(y), inside[2] - float(z), spacing[level])
    excess[i] = (u - inside) * spacing[level]


@wp.kernel
def interpolate(
    values: wp.array(dtype=wp.float16),
    want_gradient: bool,
    cell: wp.array(dtype=wp.vec3i),
    place: wp.array(dtype=wp.vec4),
    excess: wp.array(dtype=wp.vec3),
    distance: wp.array(dtype=float),
    gradient: wp.array(dtype=wp.vec3),
):
    """Trilinear value and its gradient; beyond the lattice those of the surface point seen from its border."""
    i = wp.tid()
    c = cell[i]
    f = place[i]
    n00 = c[0]
    n01 = n00 + c[2]
    n10 = n00 + c[1]
    n11 = n10 + c[2]
    v00 = float(values[n00])
    v01 = float(values[n01])
    v10 = float(values[n10])
    v11 = float(values[n11])
    z00 = float(values[n00 + 1]) - v00
    z01 = float(values[n01 + 1]) - v01
    z10 = float(values[n10 + 1]) - v10
    z11 = float(values[n11 + 1]) - v11
    v00 += z00 * f[2]
    v01 += z01 * f[2]
    v10 += z10 * f[2]
    v11 += z11 * f[2]
    v0 = v00 + (v01 - v00) * f[1]
    v1 = v10 + (v11 - v10) * f[1]
    z0 = z00 + (z01 - z00) * f[1]
    z1 = z10 + (z11 - z10) * f[1]
    y0 = v01 - v00
    value = v0 + (v1 - v0) * f[0]
    slope = wp.vec3(v1 - v0, y0 + (v11 - v10 - y0) * f[0], z0 + (z1 - z0) * f[0]) / f[3]

    outside = excess[i]
    if outside[0] != 0.0 or outside[1] != 0.0 or outside[2] != 0.0:
        # From where the point leaves the lattice the surface lies `value` back along the slope.
        leap = outside + value * wp.normalize(slope)
        value = wp.length(leap)
        slope = leap / value
    distance[i] = value
    if want_gradient:
        gradient[i] = slope
