"""Where the edges of one mesh pass through the faces of another, for warp.

Whether an edge passes a triangle follows from the signs of volumes of tetrahedra. Each is computed in double precision
from the same vertices in the same order, whichever pair of faces asks, so that neighbouring faces never disagree.
"""

import warp as wp

import grabnet.geometry.kernels.launch  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.struct
class Surface:
    """A mesh: faces (F, 3) of vertices, and their edges (F, 3), of which number k joins corners k and k + 1."""

    points: wp.array(dtype=wp.vec3)
    faces: wp.array2d(dtype=int)
    face_edges: wp.array2d(dtype=int)


@wp.struct
class Hits:
    """Crossings found, one a row.

    of_object: whether an edge of the object crosses a face of the body, or the other way round. edge, face: which.
    body_face, object_face: the pair of faces in which it was found. along: share of the way from the edge's
    lower-numbered vertex to the other. entering: whether that way leads from the front of the face to its back.
    """

    of_object: wp.array(dtype=wp.bool)
    edge: wp.array(dtype=int)
    face: wp.array(dtype=int)
    body_face: wp.array(dtype=int)
    object_face: wp.array(dtype=int)
    along: wp.array(dtype=float)
    entering: wp.array(dtype=wp.bool)


@wp.func
def volume(a: wp.vec3, b: wp.vec3, c: wp.vec3, d: wp.vec3) -> wp.float64:
    """Six times the signed volume: positive where d lies in front of triangle abc."""
    origin = wp.vec3d(a)
    return wp.dot(wp.cross(wp.vec3d(b) - origin, wp.vec3d(c) - origin), wp.vec3d(d) - origin)


@wp.func
def passes(body: Surface, thing: Surface, p: int, q: int, a: int, b: int) -> int:
    """On which side the body's edge pq passes the object's edge ab: 1 or -1, turned with either edge."""
    sign = wp.int32(1)
    if p > q:
        sign = -sign
    if a > b:
        sign = -sign
    v = volume(
        body.points[wp.min(p, q)], body.points[wp.max(p, q)], thing.points[wp.min(a, b)], thing.points[wp.max(a, b)]
    )
    if v < wp.float64(0.0):
        sign = -sign
    return sign


@wp.func
def overlap(low_a: wp.vec3, high_a: wp.vec3, low_b: wp.vec3, high_b: wp.vec3) -> bool:
    return (
        low_a[0] <= high_b[0] and low_b[0] <= high_a[0]
        and low_a[1] <= high_b[1] and low_b[1] <= high_a[1]
        and low_a[2] <= high_b[2] and low_b[2] <= high_a[2]
    )  # fmt: skip


@wp.kernel
def find_crossings(
    body: Surface,
    thing: Surface,
    mesh: wp.uint64,
    low: wp.vec3,
    high: wp.vec3,
    fill: bool,
    hits: Hits,
    body_faces: wp.array(dtype=int),
    start: wp.array(dtype=int),
    count: wp.array(dtype=int),
):
    """All crossings of one body face with the object's faces: first counted, then written from `start` on."""
    row = wp.tid()
    i = body_faces[row]
    if fill and count[row] == 0:
        return
    face_low = body.points[body.faces[i, 0]]
    face_high = face_low
    for k in range(1, 3):
        corner = body.points[body.faces[i, k]]
        face_low = wp.min(face_low, corner)
        face_high = wp.max(face_high, corner)
    found = wp.int32(0)
    if overlap(face_low, face_high, low, high):
        query = wp.mesh_query_aabb(mesh, face_low, face_high)
        j = wp.int32(0)
        while wp.mesh_query_aabb_next(query, j):
            # Signs of the nine pairs of edges, m of the object's face and k of the body's.
            signs = wp.mat33()
            for k in range(3):
                for m in range(3):
                    signs[k, m] = float(
                        passes(
                            body, thing,
                            body.faces[i, k], body.faces[i, (k + 1) % 3],
                            thing.faces[j, m], thing.faces[j, (m + 1) % 3],
                        )
                    )  # fmt: skip
            for k in range(3):
                if signs[k, 0] == signs[k, 1] and signs[k, 1] == signs[k, 2]:
                    p = wp.min(body.faces[i, k], body.faces[i, (k + 1) % 3])
                    q = wp.max(body.faces[i, k], body.faces[i, (k + 1) % 3])
                    before = volume(
                        thing.points[thing.faces[j, 0]], thing.points[thing.faces[j, 1]],
                        thing.points[thing.faces[j, 2]], body.points[p],
                    )  # fmt: skip
                    after = volume(
                        thing.points[thing.faces[j, 0]], thing.points[thing.faces[j, 1]],
                        thing.points[thing.faces[j, 2]], body.points[q],
                    )  # fmt: skip
                    if (before < wp.float64(0.0)) != (after < wp.float64(0.0)):
                        if fill:
                            at = start[row] + found
                            hits.of_object[at] = False
                            hits.edge[at] = body.face_edges[i, k]
                            hits.face[at] = j
                            hits.body_face[at] = i
                            hits.object_face[at] = j
                            hits.along[at] = float(before / (before - after))
                            hits.entering[at] = after < wp.float64(0.0)
                        found += 1
            for m in range(3):
                if signs[0, m] == signs[1, m] and signs[1, m] == signs[2, m]:
                    p = wp.min(thing.faces[j, m], thing.faces[j, (m + 1) % 3])
                    q = wp.max(thing.faces[j, m], thing.faces[j, (m + 1) % 3])
                    before = volume(
                        body.points[body.faces[i, 0]], body.points[body.faces[i, 1]],
                        body.points[body.faces[i, 2]], thing.points[p],
                    )  # fmt: skip
                    after = volume(
                        body.points[body.faces[i, 0]], body.points[body.faces[i, 1]],
                        body.points[body.faces[i, 2]], thing.points[q],
                    )  # fmt: skip
                    if (before < wp.float64(0.0)) != (after < wp.float64(0.0)):
                        if fill:
                            at = start[row] + found
                            hits.of_object[at] = True
                            hits.edge[at] = thing.face_edges[j, m]
                            hits.face[at] = i
                            hits.body_face[at] = i
                            hits.object_face[at] = j
                            hits.along[at] = float(before / (before - after))
                            hits.entering[at] = after < wp.float64(0.0)
                        found += 1
    count[row] = found
