"""Rays through a mesh, for warp."""

import warp as wp

import grabnet.geometry.kernels.launch  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.kernel
def crossings(
    mesh: wp.uint64,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    count: wp.array(dtype=int),
):
    i = wp.tid()
    count[i] = wp.mesh_query_ray_count_intersections(mesh, origins[i], directions[i])
