"""Overlap of the spheres of one body with each other, in many poses."""

import warp as wp

import grabnet.geometry.kernels.launch  # noqa: F401  (starts warp)

wp.set_module_options({"enable_backward": False})


@wp.kernel
def overlaps(
    lanes: int,
    apart: wp.array(dtype=float),
    first: wp.array(dtype=int),
    partner: wp.array(dtype=int),
    centres: wp.array2d(dtype=wp.vec3),
    energy: wp.array2d(dtype=float),
    gradient: wp.array2d(dtype=wp.vec3),
):
    """Half the sum of squared overlaps of each sphere with its partners, and its gradient in the sphere's centre.

    Sphere i keeps `apart[k]` from sphere `partner[k]`, for k from `first[i]` up to `first[i + 1]`; each pair is listed
    from both sides.
    """
    row, lane = wp.tid()
    for i in range(lane, centres.shape[1], lanes):
        here = centres[row, i]
        total = wp.float32(0.0)
        push = wp.vec3(0.0, 0.0, 0.0)
        for k in range(first[i], first[i + 1]):
            offset = here - centres[row, partner[k]]
            squared = wp.dot(offset, offset)
            if squared < apart[k] * apart[k]:
                distance = wp.max(wp.sqrt(squared), 1.0e-6)
                overlap = apart[k] - distance
                total += 0.5 * overlap * overlap
                push -= (2.0 * overlap / distance) * offset
        energy[row, i] = total
        gradient[row, i] = push
