"""Mesh queries for warp."""

import warp as wp

import grabnet.geometry.kernels.launch  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})

# Accuracy of the fast winding number: a cluster of faces further than this many of its radii counts as one dipole.
WINDING_ACCURACY = wp.constant(2.0)
# Of an open surface the winding number falls from 1 to 0 through the opening; half of it closes the opening evenly.
WINDING_INSIDE = wp.constant(0.5)
# How far from the diagonal the rays may point; the diagonal itself would run along too many edges.
RAY_SPREAD = wp.constant(0.1)


@wp.kernel
def closest_point(
    mesh: wp.uint64,
    max_distance: float,
    points: wp.array(dtype=wp.vec3),
    distance: wp.array(dtype=float),
    position: wp.array(dtype=wp.vec3),
    face: wp.array(dtype=int),
):
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], max_distance)
    if query.result:
        position[i] = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance[i] = wp.length(position[i] - points[i])
        face[i] = query.face


@wp.func
def closest_on_segment(p: wp.vec3, a: wp.vec3, b: wp.vec3) -> wp.vec3:
    ab = b - a
    return a + ab * wp.clamp(wp.dot(p - a, ab) / wp.max(wp.length_sq(ab), 1.0e-20), 0.0, 1.0)


@wp.func
def closest_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Nearest point of a triangle: across the edge that p lies beyond, or else on the face."""
    ab, ac, bc = b - a, c - a, c - b
    normal = wp.cross(ab, ac)
    inside = wp.bool(wp.length_sq(normal) > 0.0)
    inside = inside and wp.dot(wp.cross(normal, ab), p - a) >= 0.0
    inside = inside and wp.dot(wp.cross(normal, bc), p - b) >= 0.0
    inside = inside and wp.dot(wp.cross(ac, normal), p - a) >= 0.0
    if inside:
        return p - normal * (wp.dot(normal, p - a) / wp.length_sq(normal))
    best = closest_on_segment(p, a, b)
    for k in range(2):
        other = closest_on_segment(p, c, a)
        if k == 1:
            other = closest_on_segment(p, b, c)
        if wp.length_sq(other - p) < wp.length_sq(best - p):
            best = other
    return best


@wp.kernel
def closest_of_faces(
    mesh: wp.uint64,
    max_distance: float,
    chosen: wp.array(dtype=wp.bool),
    points: wp.array(dtype=wp.vec3),
    distance: wp.array(dtype=float),
    position: wp.array(dtype=wp.vec3),
    face: wp.array(dtype=int),
):
    """As `closest_point`, among the chosen faces only."""
    i = wp.tid()
    p = points[i]
    reach = wp.vec3(max_distance)
    best = float(max_distance)
    query = wp.mesh_query_aabb(mesh, p - reach, p + reach)
    j = wp.int32(0)
    while wp.mesh_query_aabb_next(query, j):
        if chosen[j]:
            q = closest_on_triangle(
                p,
                wp.mesh_get_point(mesh, 3 * j),
                wp.mesh_get_point(mesh, 3 * j + 1),
                wp.mesh_get_point(mesh, 3 * j + 2),
            )
            if wp.length(q - p) <= best:
                best = wp.length(q - p)
                distance[i] = best
                position[i] = q
                face[i] = j


@wp.kernel
def signed_distance(
    mesh: wp.uint64,
    max_distance: float,
    rays: int,
    points: wp.array(dtype=wp.vec3),
    distance: wp.array(dtype=float),
):
    """Signed by the parity of crossings along some rays, or where there are none by the winding number."""
    i = wp.tid()
    p = points[i]
    if rays > 0:
        query = wp.mesh_query_point_sign_parity(mesh, p, max_distance, rays, RAY_SPREAD)
    else:
        query = wp.mesh_query_point_sign_winding_number(mesh, p, max_distance, WINDING_ACCURACY, WINDING_INSIDE)
    if query.result:
        position = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance[i] = query.sign * wp.length(position - p)


@wp.kernel
def first_hit(
    mesh: wp.uint64,
    start: wp.array(dtype=wp.vec3),
    end: wp.array(dtype=wp.vec3),
    share: wp.array(dtype=float),
):
    i = wp.tid()
    way = end[i] - start[i]
    length = wp.length(way)
    if length > 0.0:
        query = wp.mesh_query_ray(mesh, start[i], way / length, length)
        if query.result:
            share[i] = query.t / length
