"""Hands to measure: as people hold them, in the rest frame of the open hand or turned; and plates to hold."""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from torch import Tensor

from grabnet.contact.contacts import Contacts
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.queries import MeshQuery
from grabnet.grasping.grasp_hand import GraspHand, GraspPose


def bent(hand: GraspHand, *flexion: float) -> GraspPose:
    """Hands in their rest frame, all fingers bent by so many radians at every joint."""
    angles = torch.zeros(len(flexion), 21)
    bends = [k for k, name in enumerate(hand.anatomy.angle_names) if "abduction" not in name and "thumb" not in name]
    angles[:, bends] = torch.tensor(flexion).unsqueeze(1)
    return GraspPose(torch.eye(3).expand(len(flexion), 3, 3), hand.joints[:1].expand(len(flexion), 3), angles)


def plate(thickness: float, middle: Tensor, normal: Tensor, side: float = 0.3) -> Mesh:
    """A square plate, closed, of small enough faces."""
    box = trimesh.creation.box((side, side, thickness))
    box.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), normal.numpy()))
    return Mesh(box.vertices + middle.numpy(), box.faces).subdivided().subdivided()


def contacts_with(mesh: Mesh, vertices: Tensor, finger: Tensor) -> Contacts:
    distances = MeshQuery(mesh).signed_distance(vertices.flatten(0, 1)).view(vertices.shape[:2])
    return Contacts(distances=distances, finger=finger)


def mirrored(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices * np.array([-1, 1, 1], np.float32), mesh.faces[:, ::-1])
