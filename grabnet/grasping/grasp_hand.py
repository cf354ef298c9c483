"""A hand of one shape as grasping needs it: skin, and spheres inside fingers, palm and forearm, posed together."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy, vertex_normals
from grabnet.body.hand import HandModel, HandParameters
from grabnet.body.skeleton import HAND_JOINTS
from grabnet.body.skinning import forward_kinematics, skin, tree_levels
from grabnet.grasping.spheres import clearance, fill

FOREARM_RADIUS = 0.035  # metres, a slim adult forearm near the wrist
PAD_VERTICES = 12  # a pad is represented by at most so many
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


class GraspHand:
    """One hand shape, ready to be posed by the thousand.

    Args:
        hand, anatomy: the model and its labels.
        betas: (n,) shape.

    Attributes:
        rest (V, 3), joints (16, 3): the shape at rest. normals (V, 3): at rest, unit.
        radii (S,), sphere_bone (S,): the spheres that fill fingers and palm, and the bone each moves with.
        apart (S, S): metres that the spheres' centres keep from each other, see `clearance`.
        sample (N,): vertices that stand for the whole skin while optimising: pads and a quarter of all.
        pads (P, K): members of `sample` on each pad, padded; pad_mask (P, K): which of them count. pad_names (P,).
    """

    def __init__(self, hand: HandModel, anatomy: Anatomy, betas: Tensor):
        self.anatomy, self.weights, self.parents = anatomy, hand.weights, hand.parents
        self.rest = hand.shaped(betas)
        self.joints = hand.rest_joints(self.rest)
        self.normals = vertex_normals(self.rest, hand.faces)
        self._levels = tree_levels(hand.parents)

        centres, self.radii, self.sphere_bone = fill(self.rest, self.joints, anatomy)
        self.apart = clearance(centres, self.radii, self.sphere_bone)
        backward = self.joints[0] - self.joints[[1, 4, 7, 10]].mean(0)
        backward = backward / backward.norm()
        forearm = self.joints[0] + backward * self.rest.new_tensor(FOREARM_REACH).unsqueeze(1)
        self._inner = torch.cat([centres, forearm])
        bones = torch.cat([self.sphere_bone, self.sphere_bone.new_zeros(len(forearm))])
        self._inner_weights = torch.nn.functional.one_hot(bones, len(HAND_JOINTS)).to(self.rest)
        # The point inside that each vertex covers: where a finger is, if its skin is on the far side of a thin wall.
        apart = torch.cdist(self.rest, centres) + (anatomy.bone.unsqueeze(1) != self.sphere_bone).to(self.rest)
        self.foot = apart.argmin(1)

        self.pad_names = tuple(anatomy.pads)
        pads = [pad[:: -(-len(pad) // PAD_VERTICES)] for pad in anatomy.pads.values()]
        longest = torch.arange(max(len(pad) for pad in pads))
        members = torch.stack([pad[longest.clamp(max=len(pad) - 1)] for pad in pads])
        self.pad_mask = torch.stack([longest < len(pad) for pad in pads])
        self.sample = torch.cat([members.flatten(), torch.arange(0, len(self.rest), 4)]).unique()
        self.pads = torch.searchsorted(self.sample, members)

    def posed(self, pose: GraspPose, vertices: Tensor | None = None) -> Posed:
        """Pose the hand; `vertices` limits the skin to those."""
        rotations = torch.cat([pose.rotation.unsqueeze(1), self.anatomy.hand_pose(pose.angles)], 1)
        world, position = forward_kinematics(rotations, self.joints.unsqueeze(0), self.parents, self._levels)
        position = position + (pose.wrist - self.joints[0]).unsqueeze(1)
        offset = position - (world @ self.joints.unsqueeze(-1)).squeeze(-1)
        rest, weights = (self.rest, self.weights) if vertices is None else (self.rest[vertices], self.weights[vertices])
        points = skin(torch.cat([rest, self._inner]), torch.cat([weights, self._inner_weights]), world, offset)
        return Posed(*points.split([len(rest), len(self.radii), len(FOREARM_REACH)], 1), world)

    def posed_normals(self, rotations: Tensor, vertices: Tensor) -> Tensor:
        """(B, N, 3) normals, not quite of unit length, of the given vertices under bone rotations (B, 16, 3, 3)."""
        return skin(self.normals[vertices], self.weights[vertices], rotations, torch.zeros_like(rotations[..., 0]))

    def parameters(self, pose: GraspPose) -> HandParameters:
        """The same poses as parameters of the hand model."""
        return HandParameters(pose.rotation, self.anatomy.hand_pose(pose.angles), pose.wrist - self.joints[0])
