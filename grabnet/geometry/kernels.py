"""Mesh queries for warp."""

import warp as wp

import grabnet.geometry.warping  # noqa: F401  (starts warp)

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
