"""Contact of sampled grasps, annotated as the data set is (paper 4, "Contact"): vertex by vertex, by part of the hand.

In a folder of results:
    contact.npz   object (N, V of the object) uint8, the part of the hand that touches each vertex, 0 for none;
                  hand (N, V) uint8, the own part of each touching vertex. Parts are numbered as in GRAB (ref. 1),
                  vertices as in meshes/.
    contact/      with format=ply: object_000.ply, hand_000.ply …, coloured by part, in the frame and units of the mesh
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.body.skeleton import LEFT_HAND_PARTS, RIGHT_HAND_PARTS
from grabnet.contact.bones import Bones
from grabnet.contact.coloured import write_labelled
from grabnet.contact.hands import ContactMaps, HandAnnotator
from grabnet.contact.rules import ContactRules
from grabnet.generation.grasps import Grasps
from grabnet.geometry.mesh import Mesh

ARRAYS, MESHES = "contact.npz", "contact"


def contact_maps(grasps: Grasps, hand: HandModel, rules: ContactRules) -> ContactMaps:
    """Find what touches.

    Args:
        grasps: of the object.
        hand: right hand model that they were sampled with.
        rules: what ε, which is the grasps' own, is measured to, and whose part it is.
    """
    labels = RIGHT_HAND_PARTS if grasps.side == "right" else LEFT_HAND_PARTS
    rest = hand.shaped(grasps.betas[0].to(hand.v_template.device)).cpu().numpy()
    bone = Anatomy.of(hand).bone.cpu().numpy()
    rotation, shift = grasps.to_object[:3, :3], grasps.to_object[:3, 3]
    vertices = (grasps.vertices.double().numpy() @ rotation.T + shift).astype(np.float32)
    annotate = HandAnnotator(
        grasps.mesh.transformed(grasps.to_object),
        vertices[0],
        grasps.faces.numpy(),
        np.array(labels, np.uint8)[bone],
        grasps.contacts.contact_distance,
        rules,
        Bones.of(hand, rest, labels),  # a mirrored hand's follow its vertices likewise
    )
    return annotate(vertices)


def write_contact_maps(folder: Path, maps: ContactMaps, grasps: Grasps, with_meshes: bool) -> None:
    """Write contact.npz, and with meshes the folder contact, into a folder."""
    np.savez_compressed(folder / ARRAYS, **maps._asdict())
    if with_meshes:
        for i, vertices in enumerate(grasps.vertices.numpy()):
            write_labelled(folder / MESHES / f"object_{i:03d}.ply", grasps.mesh, maps.object[i])
            write_labelled(folder / MESHES / f"hand_{i:03d}.ply", Mesh(vertices, grasps.faces.numpy()), maps.hand[i])
