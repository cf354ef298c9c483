"""Mesh kernels for warp, which compiles them at first use and keeps the result in its own cache.

Import this module only where a mesh is queried: warp takes a third of a second to load.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp

# Accuracy of the fast winding number: a cluster of faces further than this many of its radii counts as one dipole.
WINDING_ACCURACY = wp.constant(2.0)
# Of an open surface the winding number falls from 1 to 0 through the opening; half of it closes the opening evenly.
WINDING_INSIDE = wp.constant(0.5)


@contextmanager
def _silent_stderr() -> Iterator[None]:
    """Hide what native code writes to stderr, which no Python setting reaches."""
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


wp.config.log_level = wp.LOG_WARNING
wp.set_module_options({"enable_backward": False})
with _silent_stderr():  # on a machine without an NVIDIA driver warp says so at every start
    wp.init()


@wp.kernel
def closest_point(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    max_distance: float,
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
    points: wp.array(dtype=wp.vec3),
    max_distance: float,
    distance: wp.array(dtype=float),
):
    i = wp.tid()
    query = wp.mesh_query_point_sign_winding_number(mesh, points[i], max_distance, WINDING_ACCURACY, WINDING_INSIDE)
    if query.result:
        position = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance[i] = query.sign * wp.length(position - points[i])


@wp.kernel
def distance_within(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    bounds: wp.array(dtype=float),
    distance: wp.array(dtype=float),
):
    """Unsigned distance, sought no further than a bound known for each point."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], bounds[i])
    if query.result:
        position = wp.mesh_eval_position(mesh, query.face, query.u, query.v)
        distance[i] = wp.length(position - points[i])
