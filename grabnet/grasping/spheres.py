"""Spheres that fill fingers and palm: how they are placed, and by how much they overlap in a posed hand."""

from __future__ import annotations

import torch
from torch import Tensor

from grabnet.body.anatomy import FINGERS, Anatomy
from grabnet.body.skeleton import HAND_JOINTS
from grabnet.geometry.kernels import spheres as kernels
from grabnet.geometry.kernels.launch import launch

# Of their distance at rest, what spheres at the root of the thumb keep from those of the palm: flesh gives way there.
THUMB_SHARE = 0.7


def fill(rest: Tensor, joints: Tensor, anatomy: Anatomy) -> tuple[Tensor, Tensor, Tensor]:
    """Centres (S, 3), radii (S,) and bones (S,) of spheres along the finger bones and under the palm."""
    spheres = []
    for finger, name in enumerate(FINGERS):
        first = HAND_JOINTS.index(f"{name}1")
        ends = [*joints[first : first + 3], rest[anatomy.tips[finger]]]
        for k, shares in enumerate(((0.15, 0.5, 0.85), (0.15, 0.5, 0.85), (0.15, 0.48, 0.8))):
            skin_of_bone = rest[anatomy.bone == first + k]
            along = ends[k + 1] - ends[k]
            along = along / along.norm()
            for share in shares:
                centre = torch.lerp(ends[k], ends[k + 1], share)
                section = skin_of_bone[((skin_of_bone - centre) @ along).abs() < 0.008]
                if len(section) >= 4:  # joints lie nearer the back of the finger than its middle
                    shift = (section - centre).mean(0)
                    centre = centre + 0.8 * (shift - (shift @ along) * along)
                reach = section - centre
                radius = (reach - (reach @ along).unsqueeze(1) * along).norm(dim=1).median() if len(section) else 0.008
                spheres.append((centre, float(radius), first + k))
    # The palm, and the thick roots of the fingers, by spheres against the skin that faces the object.
    palmar = anatomy.frame[1]
    knuckles = joints[[1, 4, 10, 7]]  # index, middle, ring, pinky
    beyond = joints[[2, 5, 11, 8]]
    roots = (anatomy.bone == 0) | ((anatomy.bone - 1) % 3 == 0)
    for across, finger in enumerate((1, 4, 10, 7)):
        for share, end, bone, skin_of_bone in (
            *((share, knuckles[across], 0, rest[anatomy.bone == 0]) for share in (0.2, 0.4, 0.6, 0.8, 0.95)),
            *((share, beyond[across], finger, rest[roots & (anatomy.bone < 13)]) for share in (0.05, 0.3)),
        ):
            centre = torch.lerp(joints[0] if bone == 0 else knuckles[across], end, share)
            offset = skin_of_bone - centre
            height = offset @ palmar
            height = height[(offset - height.unsqueeze(1) * palmar).norm(dim=1) < 0.011]
            if len(height) >= 2:
                low, high = height.min(), height.max()
                if (radius := min(float((high - low) / 2), 0.014 if bone == 0 else 0.010)) > 0.006:
                    spheres.append((centre + (high - radius) * palmar, radius, bone))
    centres, radii, bones = zip(*spheres, strict=True)
    return torch.stack(centres), rest.new_tensor(radii), torch.tensor(bones, device=rest.device)


def clearance(centres: Tensor, radii: Tensor, bone: Tensor) -> Tensor:
    """(S, S) metres that centres of spheres must keep apart: of different fingers, and of fingers and palm; else 0.

    The roots of the fingers are part of the palm; the thumb's root may come nearer to it than at rest, not into it.

    Args:
        centres: (S, 3) metres, of the hand at rest, which counts as free of overlap.
        radii: (S,) metres.
        bone: (S,) joint that each moves with.
    """
    finger = torch.where(bone > 0, (bone - 1) // 3, -1)
    near_palm = (bone > 0) & (((bone - 1) % 3 == 0) | ((finger == 4) & ((bone - 1) % 3 < 2)))
    palm = finger == -1
    joined = (near_palm.unsqueeze(1) & palm) | (palm.unsqueeze(1) & near_palm)
    of_thumb = (finger.unsqueeze(1) == 4) | (finger == 4)
    separate = (finger.unsqueeze(1) != finger) & (~joined | of_thumb)
    share = torch.where(joined, THUMB_SHARE, 0.97)
    apart = torch.minimum(0.92 * (radii.unsqueeze(1) + radii), share * torch.cdist(centres, centres))
    return apart * separate


def overlaps(spheres: Tensor, apart: Tensor) -> Tensor:
    """(B, S, S) mm by which sphere centres (B, S, 3) are nearer to each other than (S, S) metres."""
    centred = (spheres - spheres.mean(1, keepdim=True).detach()) * 1e3  # mm about their middle: float32 suffices
    norm = centred.square().sum(-1)
    squared = norm.unsqueeze(2) + norm.unsqueeze(1) - 2 * centred @ centred.mT
    return (1e3 * apart - squared.clamp_min(1e-4).sqrt()).relu()


class SelfOverlap:
    """Overlap of a hand's fingers with each other and with the palm, only of spheres that may not meet.

    The same as `overlaps(spheres, apart).square().sum((1, 2)) / 2`, where differentiable, in a small part of the time.

    Args:
        apart: (S, S) metres, symmetric, see `clearance`.
    """

    def __init__(self, apart: Tensor):
        sphere, partner = apart.nonzero().unbind(1)
        counts = torch.bincount(sphere, minlength=len(apart))
        self.apart = apart[sphere, partner].float().contiguous()
        self.partner = partner.int().contiguous()
        self.first = torch.cat([counts.new_zeros(1), counts.cumsum(0)]).int()

    def __call__(self, spheres: Tensor) -> Tensor:
        """(B,) mm², of sphere centres (B, S, 3) in metres."""
        return _SelfOverlap.apply(spheres, self)


class _SelfOverlap(torch.autograd.Function):
    @staticmethod
    def forward(ctx, spheres: Tensor, pairs: SelfOverlap) -> Tensor:
        centres = spheres.detach().float().contiguous()
        energy, gradient = centres.new_empty(centres.shape[:2]), torch.empty_like(centres)
        constants = [pairs.apart, pairs.first, pairs.partner]
        launch(kernels.overlaps, [centres, energy, gradient], constants, width=centres.shape[1])
        ctx.save_for_backward(gradient)
        return 1e6 * energy.sum(1).to(spheres.dtype)

    @staticmethod
    def backward(ctx, d_energy: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return 1e6 * d_energy[:, None, None] * gradient.to(d_energy.dtype), None
