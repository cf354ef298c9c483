"""What the vertices and joints of a hand mean: fingers, pads, fingertips, joint axes and limits.

Everything is computed from weights, faces, joints and rest geometry, so it holds for any hand in MANO's schema, right
or left. Directions are named from the hand, not from its coordinate axes: distal (wrist to fingers), palmar (out of
the palm) and radial (towards the thumb).
"""

from __future__ import annotations

from dataclasses import dataclass

import roma
import torch
from torch import Tensor

from grabnet.body.hand import HandModel
from grabnet.body.skeleton import HAND_JOINTS, MODEL_FINGERS
from grabnet.geometry.rotations import matrix_to_axis_angle

FINGERS = ("thumb", "index", "middle", "ring", "pinky")

# Radians. Positive flexion bends towards the palm; positive abduction leads a finger towards the thumb's side and the
# thumb out of the palm's plane; twist is right-handed about the thumb (left-handed on a left hand).
_FINGER_LIMITS = {"mcp_flexion": (-0.35, 1.5), "mcp_abduction": (-0.3, 0.3), "pip": (0.0, 1.8), "dip": (0.0, 1.15)}
_THUMB_LIMITS = {
    "cmc_flexion": (-0.6, 0.9),
    "cmc_abduction": (-0.7, 0.9),
    "cmc_twist": (-0.7, 0.9),
    "mcp": (-0.35, 1.0),
    "ip": (-0.35, 1.3),
}
ANGLE_LIMITS = {f"{f}_{name}": limit for f in MODEL_FINGERS[:4] for name, limit in _FINGER_LIMITS.items()} | {
    f"thumb_{name}": limit for name, limit in _THUMB_LIMITS.items()
}
_JOINT_OF_ANGLE = (0, 0, 1, 2)  # of a finger, counted from its first joint
_JOINT_OF_THUMB_ANGLE = (0, 0, 0, 1, 2)

# Flexion axis of the thumb along (distal, palmar, radial) of a right hand, before it is made perpendicular to the bone.
# A straight thumb doesn't tell it; this is how the open hand's thumb, modelled slightly curled, bends.
_THUMB_FLEXION = (-0.28, 0.74, -0.62)


@dataclass(frozen=True)
class Anatomy:
    """Labels and joint axes of one hand model, on its device and in its dtype; make it with `Anatomy.of(hand)`.

    Attributes:
        frame: (3, 3) rows distal, palmar and radial in the rest pose, orthonormal.
        bone: (V,) int64, joint with the largest skinning weight.
        finger: (V,) int64 index into `FINGERS`; -1 on palm and wrist.
        tips: (5,) int64 vertices at the fingertips, in the order of `FINGERS`.
        pads: palmar vertices (int64) of each phalanx, "thumb1" (proximal) … "pinky3" (distal), of the palm
            ("palm_thenar", "palm_hypothenar", "palm_mcp") and the thumb's side of the index finger ("index_side").
        angle_names: the 21 anatomical angles.
        angle_axes: (21, 3) unit axes in the rest pose. angle_joints: (21,) int64 joint that each angle turns.
        angle_limits: (21, 2) lowest and highest, radians.
    """

    frame: Tensor
    bone: Tensor
    finger: Tensor
    tips: Tensor
    pads: dict[str, Tensor]
    angle_names: tuple[str, ...]
    angle_axes: Tensor
    angle_joints: Tensor
    angle_limits: Tensor

    @classmethod
    def of(cls, hand: HandModel, limits: dict[str, tuple[float, float]] = ANGLE_LIMITS) -> Anatomy:
        """Anatomy of the hand in its rest pose; `limits` replaces the limits of the angles it names."""
        vertices, faces, weights = hand.v_template, hand.faces, hand.weights
        joints = hand.rest_joints(vertices)
        frame = _hand_frame(joints, hand.is_right)
        bone = weights.argmax(1)
        finger = torch.tensor([-1, *(FINGERS.index(f) for f in MODEL_FINGERS for _ in range(3))], device=bone.device)
        tips = torch.stack([_tip(vertices, joints, bone, f) for f in FINGERS])
        axes = _axes(joints, vertices[tips[0]], frame, hand.is_right)
        return cls(
            frame=frame,
            bone=bone,
            finger=finger[bone],
            tips=tips,
            pads=_pads(vertices, vertex_normals(vertices, faces), joints, weights, tips, frame, axes),
            angle_names=tuple(ANGLE_LIMITS),
            angle_axes=axes,
            angle_joints=torch.tensor(
                [1 + 3 * f + j for f in range(4) for j in _JOINT_OF_ANGLE] + [13 + j for j in _JOINT_OF_THUMB_ANGLE],
                device=bone.device,
            ),
            angle_limits=vertices.new_tensor([(ANGLE_LIMITS | limits)[name] for name in ANGLE_LIMITS]),
        )

    def hand_pose(self, angles: Tensor) -> Tensor:
        """(..., 21) anatomical angles in radians → (..., 15, 3, 3) joint rotations.

        Knuckles flex first, then abduct; the base of the thumb twists, flexes, then abducts. At zero the hand is flat.
        """
        turned = _about(self.angle_axes, angles)
        fingers = turned[..., :16, :, :].unflatten(-3, (4, 4))
        knuckles = fingers[..., 1, :, :] @ fingers[..., 0, :, :]
        fingers = torch.cat([knuckles.unsqueeze(-3), fingers[..., 2:, :, :]], -3).flatten(-4, -3)
        flexion, abduction, twist = turned[..., 16:19, :, :].unbind(-3)
        base = (abduction @ flexion @ twist).unsqueeze(-3)
        return torch.cat([fingers, base, turned[..., 19:, :, :]], -3)

    def angles(self, hand_pose: Tensor) -> tuple[Tensor, Tensor]:
        """(..., 15, 3, 3) joint rotations → (..., 21) anatomical angles, and (..., 15) what they leave of each joint.

        The inverse of `hand_pose`, in radians. What is left is the angle by which a joint turns about an axis that it
        does not have, such as a fingertip sideways; the base of the thumb has all three. Flexion of the base of the
        thumb is unique within a quarter turn, all other angles within half of one either way.
        """
        flexion_axes = self.angle_axes[[4 * f + k for f in range(4) for k in (0, 2, 3)] + [16, 19, 20]]
        flexion, swing = _swing_and_twist(hand_pose, flexion_axes)
        knuckles = [0, 3, 6, 9]
        abduction_axes = self.angle_axes[[1, 5, 9, 13]]
        abduction = (swing[..., knuckles, :] * abduction_axes).sum(-1)
        left = swing.norm(dim=-1)
        left[..., knuckles] = (swing[..., knuckles, :] - abduction.unsqueeze(-1) * abduction_axes).norm(dim=-1)

        f, a, t = self.angle_axes[16:19]
        third = torch.linalg.cross(a, f)
        axes = torch.stack([a, f, third])
        base = axes @ hand_pose[..., 12, :, :] @ axes.mT
        thumb_abduction = torch.atan2(-base[..., 1, 2], base[..., 2, 2])
        thumb_flexion = torch.asin(base[..., 0, 2].clamp(-1, 1))
        thumb_twist = torch.atan2(-base[..., 0, 1], base[..., 0, 0]) * (third @ t).sign()
        left[..., 12] = 0
        fingers = [
            x
            for k in range(4)
            for x in (flexion[..., 3 * k], abduction[..., k], *flexion[..., 3 * k + 1 : 3 * k + 3].unbind(-1))
        ]
        thumb = [thumb_flexion, thumb_abduction, thumb_twist, flexion[..., 13], flexion[..., 14]]
        return torch.stack([*fingers, *thumb], -1), left


def vertex_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """(..., V, 3) vertices, (F, 3) faces → (..., V, 3) unit normals, area-weighted."""
    a, b, c = vertices[..., faces, :].unbind(-2)
    face_normals = torch.linalg.cross(b - a, c - a, dim=-1)
    total = torch.zeros_like(vertices)
    for corner in faces.unbind(-1):
        total = total.index_add(-2, corner, face_normals)
    return _unit(total)


def _hand_frame(joints: Tensor, is_right: bool) -> Tensor:
    """(3, 3) rows: distal, palmar, radial, orthonormal; from the wrist and the four knuckles."""
    index, middle, pinky, ring = (joints[1 + 3 * f] - joints[0] for f in range(4))
    palmar = _unit(torch.linalg.cross(index, pinky)) * (1 if is_right else -1)
    distal = index + middle + pinky + ring
    distal = _unit(distal - (distal @ palmar) * palmar)
    radial = torch.linalg.cross(distal, palmar) * (1 if is_right else -1)
    return torch.stack([distal, palmar, radial])


def _tip(vertices: Tensor, joints: Tensor, bone: Tensor, finger: str) -> Tensor:
    """The vertex of the distal phalanx that lies farthest along it."""
    joint = HAND_JOINTS.index(f"{finger}3")
    phalanx = (bone == joint).nonzero().squeeze(1)
    offset = vertices[phalanx] - joints[joint]
    return phalanx[(offset @ _unit(offset.mean(0))).argmax()]


def _axes(joints: Tensor, thumb_tip: Tensor, frame: Tensor, is_right: bool) -> Tensor:
    """(21, 3) axes. Rotating about a × b carries a towards b: all fingers' axes are such products of directions."""
    palmar = frame[1]
    axes = []
    for first in (1, 4, 7, 10):
        along = joints[first + 2] - joints[first]
        flexion = _unit(torch.linalg.cross(along, palmar))  # perpendicular to the palm even if the finger isn't flat
        abduction = -palmar if is_right else palmar
        axes += [flexion, abduction, flexion, flexion]
    along = _unit(joints[14] - joints[13])
    side = 1 if is_right else -1
    flexion = side * frame.new_tensor(_THUMB_FLEXION) @ frame
    flexion = _unit(flexion - (flexion @ along) * along)
    axes += [flexion, side * torch.linalg.cross(along, flexion), side * along, flexion, flexion]
    return torch.stack(axes)


def _pads(
    vertices: Tensor, normals: Tensor, joints: Tensor, weights: Tensor, tips: Tensor, frame: Tensor, axes: Tensor
) -> dict[str, Tensor]:
    """Vertices that touch an object in a grasp, by region."""
    palmar, radial = frame[1], frame[2]
    weight, bone = weights.max(1)
    pads: dict[str, Tensor] = {}
    for f, finger in enumerate(FINGERS):
        first = HAND_JOINTS.index(f"{finger}1")
        ends = [*joints[first : first + 3], vertices[tips[f]]]
        for k in range(3):
            # The thumb's pads face sideways, where flexion carries them; its base is part of the palm.
            sideways = finger == "thumb" and k > 0
            inward = torch.linalg.cross(axes[16], _unit(ends[k + 1] - ends[k])) if sideways else palmar
            pads[f"{finger}{k + 1}"] = (bone == first + k) & (weight > 0.5) & (normals @ inward > 0.45)
    # Along the palm: 0 at the wrist, 1 at the knuckles. Across it: -1/2 at the knuckle of the pinky, 1/2 at the index.
    along, _, across = ((vertices - joints[0]) @ frame.T).unbind(-1)
    knuckles = (joints[[1, 4, 7, 10]] - joints[0]) @ frame.T
    along = along / knuckles[:, 0].mean()
    across = (across - (knuckles[0, 2] + knuckles[2, 2]) / 2) / (knuckles[0, 2] - knuckles[2, 2])
    palm = (bone == 0) & (normals @ palmar > 0.5) & (along > 0.05)
    pads["palm_thenar"] = palm & (across > 0.1) & (along < 0.75)
    pads["palm_hypothenar"] = palm & (across < -0.1) & (along < 0.75)
    pads["palm_mcp"] = palm & (along >= 0.75)
    side = (bone == HAND_JOINTS.index("index2")) | (bone == HAND_JOINTS.index("index3"))
    pads["index_side"] = side & (normals @ _unit(radial + 0.3 * palmar) > 0.7)
    return {name: mask.nonzero().squeeze(1) for name, mask in pads.items()}


def _about(axes: Tensor, angles: Tensor) -> Tensor:
    """Unit axes (N, 3), angles (..., N) → (..., N, 3, 3) rotations (Rodrigues)."""
    x, y, z = axes.unbind(-1)
    o = torch.zeros_like(x)
    cross = torch.stack([o, -z, y, z, o, -x, -y, x, o], -1).unflatten(-1, (3, 3))
    sin, cos = angles.sin()[..., None, None], angles.cos()[..., None, None]
    return torch.eye(3, dtype=axes.dtype, device=axes.device) + sin * cross + (1 - cos) * (cross @ cross)


def _swing_and_twist(rotations: Tensor, axes: Tensor) -> tuple[Tensor, Tensor]:
    """Rotations (..., N, 3, 3) as a turn about unit axes (N, 3), then one about an axis perpendicular to it.

    Returns:
        angles (..., N) of the first and rotation vectors (..., N, 3) of the second, radians.
    """
    quaternion = roma.rotmat_to_unitquat(rotations)
    angles = 2 * torch.atan2((quaternion[..., :3] * axes).sum(-1), quaternion[..., 3])
    angles = torch.remainder(angles + torch.pi, 2 * torch.pi) - torch.pi  # q and -q are one rotation
    return angles, matrix_to_axis_angle(rotations @ _about(axes, -angles))


def _unit(vector: Tensor) -> Tensor:
    return vector / vector.norm(dim=-1, keepdim=True)
