"""A hand of one shape as grasping needs it: skin, and spheres inside fingers, palm and forearm, posed together."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from grabnet.body.anatomy import FINGERS, Anatomy, vertex_normals
from grabnet.body.hand import HandModel, HandParameters
from grabnet.body.skeleton import HAND_JOINTS
from grabnet.body.skinning import homogeneous, skin
from grabnet.errors import UserError
from grabnet.grasping.posing import HandChain, PosePoints, skinning_basis
from grabnet.grasping.spheres import SelfOverlap, clearance, fill

FOREARM_RADIUS = 0.035  # metres, a slim adult forearm near the wrist
PAD_VERTICES = 8  # a pad is represented by at most so many
SKIN_STRIDE = 5  # the skin between the pads is represented by every fifth vertex
FOREARM_REACH = (0.04, 0.08, 0.12, 0.16, 0.20)  # metres behind the wrist: sphere centres


class GraspPose(NamedTuple):
    """B hands in the object's frame: rotation (B, 3, 3), wrist position (B, 3) metres, anatomical angles (B, 21)."""

    rotation: Tensor
    wrist: Tensor
    angles: Tensor

    def select(self, index: Tensor | slice) -> GraspPose:
        """The chosen batch elements."""
        return GraspPose(*(x[index] for x in self))


class Posed(NamedTuple):
    """Posed skin (B, V, 3), spheres (B, S, 3), forearm centres (B, 5, 3) and bone rotations (B, 16, 3, 3)."""

    vertices: Tensor
    spheres: Tensor
    forearm: Tensor
    rotations: Tensor


class Sampled(NamedTuple):
    """What stands for posed hands while optimising, metres, and unit normals of the pads.

    skin (B, N, 3), the pads' vertices first; spheres (B, S, 3); forearm (B, 5, 3); facing (B, P, K, 3).
    """

    skin: Tensor
    spheres: Tensor
    forearm: Tensor
    facing: Tensor


class GraspHand:
    """One hand shape, ready to be posed by the thousand.

    Args:
        hand, anatomy: the model and its labels.
        betas: (n,) shape.

    Raises:
        UserError: a hand without a thumb, or with nothing to oppose it.

    Attributes:
        rest (V, 3), joints (16, 3): the shape at rest. normals (V, 3): at rest, unit.
        radii (S,), sphere_bone (S,): the spheres that fill fingers and palm, and the bone each moves with.
        apart (S, S): metres that the spheres' centres keep from each other, see `clearance`.
        sample (N,): vertices that stand for the whole skin while optimising: P pads of K vertices, then a share of the
            others. sampled_once (N,): False where a vertex only fills up a pad that has fewer.
        pads (P, K): their place in `sample`; pad_mask (P, K): which of them count. pad_names (P,).
    """

    def __init__(self, hand: HandModel, anatomy: Anatomy, betas: Tensor):
        self.anatomy, self.weights = anatomy, hand.weights
        self.rest = hand.shaped(betas)
        self.joints = hand.rest_joints(self.rest)
        self.normals = vertex_normals(self.rest, hand.faces)
        self.chain = HandChain(anatomy, self.joints, hand.parents)

        centres, self.radii, self.sphere_bone = fill(self.rest, self.joints, anatomy)
        self.apart = clearance(centres, self.radii, self.sphere_bone)
        self._pairs = SelfOverlap(self.apart)
        backward = self.joints[0] - self.joints[[1, 4, 7, 10]].mean(0)
        backward = backward / backward.norm()
        forearm = self.joints[0] + backward * self.rest.new_tensor(FOREARM_REACH).unsqueeze(1)
        self._inner = torch.cat([centres, forearm])
        bones = torch.cat([self.sphere_bone, self.sphere_bone.new_zeros(len(forearm))])
        self._inner_weights = torch.nn.functional.one_hot(bones, len(HAND_JOINTS)).to(self.rest)
        # The point inside that each vertex covers: where a finger is, if its skin is on the far side of a thin wall.
        apart = torch.cdist(self.rest, centres) + (anatomy.bone.unsqueeze(1) != self.sphere_bone).to(self.rest)
        self.foot = apart.argmin(1)

        named = {name: pad for name, pad in anatomy.pads.items() if len(pad)}
        if not ("thumb3" in named and any(f"{finger}3" in named for finger in FINGERS[1:])):
            raise UserError("The hand model has no pads at the tips of its thumb and of a finger: grasps need both.")
        self.pad_names = tuple(named)
        pads = [pad[:: -(-len(pad) // PAD_VERTICES)] for pad in named.values()]
        longest = torch.arange(max(len(pad) for pad in pads), device=self.rest.device)
        members = torch.stack([pad[longest.clamp(max=len(pad) - 1)] for pad in pads])
        self.of_thumb = torch.tensor([name.startswith("thumb") for name in self.pad_names], device=self.rest.device)
        self.pad_mask = torch.stack([longest < len(pad) for pad in pads])
        self.pads = torch.arange(members.numel(), device=self.rest.device).view(members.shape)
        others = torch.arange(0, len(self.rest), SKIN_STRIDE, device=self.rest.device)
        others = others[~torch.isin(others, members)]
        self.sample = torch.cat([members.flatten(), others])
        self.sampled_once = torch.cat([self.pad_mask.flatten(), torch.ones_like(others, dtype=torch.bool)])
        on_pads = members.flatten()
        points = homogeneous(torch.cat([self.rest[self.sample], self._inner]))
        directions = torch.nn.functional.pad(self.normals[on_pads], (0, 1))
        weights = torch.cat([self.weights[self.sample], self._inner_weights, self.weights[on_pads]])
        self._basis = skinning_basis(torch.cat([points, directions]), weights)

    def posed(self, pose: GraspPose, vertices: Tensor | None = None) -> Posed:
        """Pose the hand; `vertices` limits the skin to those."""
        transforms, _ = self.chain.transforms(*pose)
        rest, weights = (self.rest, self.weights) if vertices is None else (self.rest[vertices], self.weights[vertices])
        world, offset = transforms.split([3, 1], -1)
        weights = torch.cat([weights, self._inner_weights])
        points = skin(torch.cat([rest, self._inner]), weights, world, offset.squeeze(-1))
        return Posed(*points.split([len(rest), len(self.radii), len(FOREARM_REACH)], 1), world)

    def posed_normals(self, rotations: Tensor, vertices: Tensor) -> Tensor:
        """(B, N, 3) normals, not quite of unit length, of the given vertices under bone rotations (B, 16, 3, 3)."""
        return skin(self.normals[vertices], self.weights[vertices], rotations, torch.zeros_like(rotations[..., 0]))

    def sampled(self, pose: GraspPose) -> tuple[Tensor, Sampled]:
        """What the optimiser looks at: all points (B, N + S + 5, 3) in one, and the same by their kind."""
        everything = PosePoints.apply(*pose, self.chain, self._basis)
        n_points = len(self.sample) + len(self._inner)
        points, facing = everything.split([n_points, self.pads.numel()], 1)
        parts = points.split([len(self.sample), len(self.radii), len(FOREARM_REACH)], 1)
        return points, Sampled(*parts, facing.unflatten(1, self.pads.shape))

    def self_overlap(self, spheres: Tensor) -> Tensor:
        """(B,) mm² by which sphere centres (B, S, 3) of different fingers, or of finger and palm, are too near."""
        return self._pairs(spheres)

    def parameters(self, pose: GraspPose) -> HandParameters:
        """The same poses as parameters of the hand model."""
        return HandParameters(pose.rotation, self.anatomy.hand_pose(pose.angles), pose.wrist - self.joints[0])

    def pose_of(self, parameters: HandParameters) -> GraspPose:
        """The poses nearest to parameters of the hand model: the inverse of `parameters`.

        Turns about axes that a joint does not have are dropped.
        """
        angles, _ = self.anatomy.angles(parameters.hand_pose)
        return GraspPose(parameters.global_orient, parameters.transl + self.joints[0], angles)
