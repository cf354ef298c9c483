"""Nearest vertex of a deformed mesh, and the side of the surface that a point lies on, in two kernels.

Vertices are searched group by group; a group whose ball is further away than the best vertex so far is passed over.
"""

import warp as wp

import grabnet.geometry.warping  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.struct
class Topology:
    """What all poses of a mesh share."""

    faces: wp.array(dtype=wp.vec3i)
    members: wp.array(dtype=int)  # vertices, group after group
    group_start: wp.array(dtype=int)  # into members, and its end: one more than there are groups
    around: wp.array(dtype=int)  # faces at each vertex, vertex after vertex
    around_start: wp.array(dtype=int)


@wp.kernel
def bound(
    lanes: int,
    topology: Topology,
    vertices: wp.array2d(dtype=wp.vec3),
    balls: wp.array2d(dtype=wp.vec4),
):
    """A ball (centre, radius) around each group."""
    row, lane = wp.tid()
    for group in range(lane, balls.shape[1], lanes):
        start = topology.group_start[group]
        end = topology.group_start[group + 1]
        low = vertices[row, topology.members[start]]
        high = low
        for k in range(start + 1, end):
            v = vertices[row, topology.members[k]]
            low = wp.min(low, v)
            high = wp.max(high, v)
        centre = 0.5 * (low + high)
        square = wp.float32(0.0)
        for k in range(start, end):
            square = wp.max(square, wp.length_sq(vertices[row, topology.members[k]] - centre))
        # Rounded up, so that no member lies outside.
        balls[row, group] = wp.vec4(centre[0], centre[1], centre[2], wp.sqrt(square) * 1.00001)


@wp.func
def centre_of(ball: wp.vec4) -> wp.vec3:
    return wp.vec3(ball[0], ball[1], ball[2])


@wp.kernel
def nearest_vertex(
    lanes: int,
    topology: Topology,
    vertices: wp.array2d(dtype=wp.vec3),
    balls: wp.array2d(dtype=wp.vec4),
    queries: wp.array2d(dtype=wp.vec3),
    index: wp.array2d(dtype=int),
    behind: wp.array2d(dtype=wp.bool),
):
    """Index of the vertex nearest to each query, and whether the query lies behind the surface there."""
    row, lane = wp.tid()
    n_groups = balls.shape[1]
    for q in range(lane, queries.shape[1], lanes):
        p = queries[row, q]
        first = wp.int32(0)  # a variable: a bare 0 would be a constant to warp
        square = float(wp.inf)
        for group in range(n_groups):
            s = wp.length_sq(p - centre_of(balls[row, group]))
            if s < square:
                square = s
                first = group
        best = int(topology.members[0])
        square = float(wp.inf)
        for k in range(topology.group_start[first], topology.group_start[first + 1]):
            s = wp.length_sq(p - vertices[row, topology.members[k]])
            if s < square:
                square = s
                best = topology.members[k]
        reach = wp.sqrt(square)
        for group in range(n_groups):
            ball = balls[row, group]
            within = reach + ball[3]
            if group != first and wp.length_sq(p - centre_of(ball)) < within * within:
                for k in range(topology.group_start[group], topology.group_start[group + 1]):
                    s = wp.length_sq(p - vertices[row, topology.members[k]])
                    if s < square:
                        square = s
                        best = topology.members[k]
                reach = wp.sqrt(square)
        index[row, q] = best

        normal = wp.vec3(0.0)
        for k in range(topology.around_start[best], topology.around_start[best + 1]):
            face = topology.faces[topology.around[k]]
            a = vertices[row, face[0]]
            normal += wp.cross(vertices[row, face[1]] - a, vertices[row, face[2]] - a)
        behind[row, q] = wp.dot(p - vertices[row, best], normal) < 0.0
