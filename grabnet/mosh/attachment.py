"""Markers that ride on a body's skin: where they are in a pose, and how that changes with the pose.

A marker is a point of the resting body, its latent place, which is skinned with the weights of the skin beneath it.
Only these points are posed, never the whole body. A change of pose turns each joint by a small rotation vector in the
joint's own frame, R ← R·exp(δ): a point below the joint then moves by (W·δ) × (point - joint), W being the joint's
rotation in the world, so that the Jacobian is made of cross products.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from grabnet.body.skinning import forward_kinematics, tree_levels
from grabnet.body.whole import BodyModel
from grabnet.mosh.layouts import Layout
from grabnet.mosh.so3 import exp, hat


class Pose(NamedTuple):
    """Poses of F frames.

    rotations: (F, 55, 3, 3) of joints relative to their parents. transl: (F, 3) metres. shape: (F, S) coefficients of
    the shape directions that are solved for: expression, or betas.
    """

    rotations: Tensor
    transl: Tensor
    shape: Tensor

    def frames(self, chosen: Tensor | slice) -> Pose:
        """Chosen frames."""
        return Pose(*(value[chosen] for value in self))

    def put(self, chosen: Tensor | slice, other: Pose) -> None:
        """Set chosen frames, in place."""
        for value, new in zip(self, other, strict=True):
            value[chosen] = new.to(value.dtype)


class Placed(NamedTuple):
    """A pose in the world: points (F, M, 3) of the markers; of each pair of marker and joint above it, its `moments`
    (F, P, 3); world rotations (F, J, 3, 3); and `maps` (F, M, 3, 3), how each marker's place at rest is turned."""

    points: Tensor
    moments: Tensor
    world: Tensor
    maps: Tensor


class Attachment:
    """Markers on the skin of one subject.

    Args:
        body: in SMPL-X's schema.
        v_template: (V, 3) of the subject at rest.
        layout: where the markers sit.
        latent: (M, 3) their places at rest, metres.
        directions: (V, 3, S) shape directions that are solved for; none when omitted.
        dtype: of all computations.
        fixed: joints that are not solved for, by number, besides those that move no marker.
        device: of all computations.

    Attributes:
        joints: numbers of the joints solved for, n_joints of them.
        n: unknowns of a frame: translation, three of each joint, shape, in this order.
    """

    def __init__(
        self,
        body: BodyModel,
        v_template: Tensor,
        layout: Layout,
        latent: Tensor,
        directions: Tensor | None = None,
        dtype: torch.dtype = torch.float32,
        fixed: tuple[int, ...] = (),
        device: torch.device | str = "cpu",
    ):
        corners = torch.tensor([marker.vertices for marker in layout.markers])
        at = torch.tensor([marker.weights for marker in layout.markers], dtype=torch.float64)
        self.dtype, self.parents, self._levels = dtype, body.parents, tree_levels(body.parents)
        self.weights = (body.weights.double()[corners] * at.unsqueeze(-1)).sum(1).to(dtype)
        self.latent = latent.to(dtype)
        self.rest_joints = body.rest_joints(v_template).to(dtype)
        n_shapes = 0 if directions is None else directions.shape[-1]
        directions = body.v_template.new_zeros(len(v_template), 3, 0) if directions is None else directions
        self.shapes = (directions.double()[corners] * at[..., None, None]).sum(1).to(dtype)
        self.joint_shapes = torch.einsum("jv,vds->jds", body.J_regressor, directions).to(dtype)
        self.correctives = None
        if body.has_pose_correctives:
            blended = body.posedirs.unflatten(1, (-1, 3))[:, corners].double() * at.unsqueeze(-1)  # (9·54, M, 3, 3)
            self.correctives = blended.sum(2).unflatten(0, (-1, 9)).permute(2, 3, 0, 1).to(dtype).contiguous()
        self._pair_up(fixed)
        self.n_shapes, self.n_joints = n_shapes, len(self.joints)
        self.n = 3 + 3 * self.n_joints + n_shapes
        self.device = torch.device(device)
        for name, value in vars(self).items():
            if isinstance(value, Tensor):
                setattr(self, name, value.to(self.device))

    def _pair_up(self, fixed: tuple[int, ...]) -> None:
        """Number the pairs of markers and joints that move them, ancestors included; those of the root come first."""
        n_joints = len(self.parents)
        below = torch.eye(n_joints, dtype=self.dtype)
        for joint in reversed(range(1, n_joints)):
            below[self.parents[joint]] += below[joint]
        carried = self.weights.unsqueeze(1) * below  # (M, joint, its descendants)
        moves = carried.sum(-1) > 1e-6
        joint, marker = moves.T.nonzero().T  # by joint: the root's pairs, one of every marker, come first
        self._pair_weights = carried[marker, joint]  # (P, J)
        self._pair_sums = self._pair_weights.sum(1)
        self._pair_joint, self._pair_marker = joint, marker
        seen = [j for j in joint.unique().tolist() if j not in fixed]
        self.joints = torch.tensor(seen)
        number = torch.full((n_joints,), -1)
        number[self.joints] = torch.arange(len(seen))
        self._solved = (number[joint] >= 0).nonzero().squeeze(1)
        self._column, self._row = number[joint[self._solved]], marker[self._solved]

    @property
    def n_markers(self) -> int:
        return len(self.latent)

    def rest(self, pose: Pose) -> Tensor:
        """(F or 1, M, 3) places at rest, with what shape and pose correctives add to them."""
        rest = self.latent.unsqueeze(0)
        if self.n_shapes:
            rest = rest + torch.einsum("mds,fs->fmd", self.shapes, pose.shape)
        if self.correctives is not None:
            feature = pose.rotations[:, 1:] - torch.eye(3, dtype=self.dtype, device=self.device)
            rest = rest + torch.einsum("mdjk,fjk->fmd", self.correctives, feature.flatten(-2))
        return rest

    def place(self, pose: Pose) -> Placed:
        """Pose the markers."""
        joints = self.rest_joints.unsqueeze(0)
        if self.n_shapes:
            joints = joints + torch.einsum("jds,fs->fjd", self.joint_shapes, pose.shape)
        world, at = forward_kinematics(pose.rotations, joints, self.parents, self._levels)
        at = at + pose.transl.unsqueeze(1)
        offset = at - (world @ joints.unsqueeze(-1)).squeeze(-1)
        transforms = torch.cat([world, offset.unsqueeze(-1)], -1).flatten(-2)  # (F, J, 12)
        blended = (self._pair_weights @ transforms).unflatten(-1, (3, 4))  # (F, P, 3, 4)
        rest = self.rest(pose).expand(len(world), -1, -1)
        carried = (blended[..., :3] @ rest[:, self._pair_marker].unsqueeze(-1)).squeeze(-1) + blended[..., 3]
        moments = carried - self._pair_sums.unsqueeze(-1) * at[:, self._pair_joint]
        m = self.n_markers
        return Placed(carried[:, :m], moments, world, blended[:, :m, :, :3])

    def jacobian(self, pose: Pose, placed: Placed) -> Tensor:
        """(F, n, 3·M): how the markers' coordinates change with each unknown, transposed."""
        f, m = len(placed.points), self.n_markers
        jacobian = torch.zeros(f, self.n, 3 * m, dtype=self.dtype, device=placed.points.device)
        for axis in range(3):
            jacobian[:, axis, axis::3] = 1
        turned = jacobian[:, 3 : 3 + 3 * self.n_joints].view(f, self.n_joints, 3, m, 3)
        axes = placed.world[:, self._pair_joint[self._solved]].mT  # (F, P, 3, 3): a row is one of the joint's axes
        moments = placed.moments[:, self._solved].unsqueeze(2)
        turned[:, self._column, :, self._row] = torch.linalg.cross(axes, moments, dim=-1).transpose(0, 1)
        if self.correctives is not None:
            self._add_correctives(pose, placed, turned)
        if self.n_shapes:
            jacobian[:, 3 + 3 * self.n_joints :] = self._shape_jacobian(placed).flatten(2)
        return jacobian

    def _add_correctives(self, pose: Pose, placed: Placed, turned: Tensor) -> None:
        """What turning a joint changes at rest: d vec(R·exp(δ)) = vec(R·[e]×)."""
        generators = hat(torch.eye(3, dtype=self.dtype, device=self.device))
        solved = self.joints[self.joints > 0]
        change = (pose.rotations[:, solved].unsqueeze(2) @ generators).flatten(-2)  # (F, joints, 3, 9)
        at_rest = torch.einsum("mdjk,fjck->fjcmd", self.correctives[:, :, solved - 1], change)
        first = len(self.joints) - len(solved)
        turned[:, first:] += torch.einsum("fmed,fjcmd->fjcme", placed.maps, at_rest)

    def _shape_jacobian(self, placed: Placed) -> Tensor:
        """(F, S, M, 3): shape moves points and joints at rest, and each joint carries what hangs on it along."""
        moved: list[Tensor] = []
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                moved.append(self.joint_shapes[joint].expand(len(placed.world), -1, -1))
            else:
                step = self.joint_shapes[joint] - self.joint_shapes[parent]
                moved.append(moved[parent] + placed.world[:, parent] @ step)
        shift = torch.stack(moved, 1) - placed.world @ self.joint_shapes  # (F, J, 3, S)
        change = placed.maps @ self.shapes + torch.einsum("mj,fjds->fmds", self.weights, shift)
        return change.permute(0, 3, 1, 2)

    def moved(self, pose: Pose, delta: Tensor) -> Pose:
        """The poses changed by (F, n) small steps."""
        transl, turn, shape = delta.split([3, 3 * self.n_joints, self.n_shapes], 1)
        rotations = pose.rotations.clone()
        rotations[:, self.joints] = rotations[:, self.joints] @ exp(turn.unflatten(1, (-1, 3)))
        return Pose(rotations, pose.transl + transl, pose.shape + shape)

    def neutral(self, f: int) -> Pose:
        """F frames at rest."""
        eye = torch.eye(3, dtype=self.dtype, device=self.device).repeat(f, len(self.parents), 1, 1)
        return Pose(eye, eye.new_zeros(f, 3), eye.new_zeros(f, self.n_shapes))
