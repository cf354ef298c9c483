"""From what was solved to a recording in GRAB's layout."""

from __future__ import annotations

import re

import numpy as np
import torch
from torch import Tensor

from grabnet.body.skeleton import LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS
from grabnet.body.skinning import forward_kinematics, tree_levels
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import BodyTrack, ContactTrack, HandTrack, RigidTrack, Sequence
from grabnet.geometry.mesh import Mesh
from grabnet.mosh.attachment import Pose
from grabnet.mosh.rigid import RigidMotion
from grabnet.mosh.so3 import log
from grabnet.mosh.subjects import Subject

N_COMPS = 24  # principal components of a hand pose, as GRAB's
TABLE_MESH = "tools/table_meshes/table.ply"
NO_OBJECT = "none"  # a capture without objects has one of this name, of no size, which stays at the origin
_BATCH = 512


def assemble(
    name: str,
    subject: Subject,
    v_template: Tensor,
    pose: Pose,
    rate: float,
    object_name: str,
    motion: RigidMotion | None,
    mesh: Mesh | None,
) -> Sequence:
    """A recording, without contact.

    Args:
        name: `<subject>/<object>_<action>_<k>`, where the action is taken from.
        subject: of the body.
        v_template: (V, 3) its shape.
        pose: of all frames.
        rate: frames per second.
        object_name: of the object; `NO_OBJECT` for none.
        motion: of the object.
        mesh: of the object.
    """
    n = len(pose.transl)
    fullpose = log(pose.rotations.double()).flatten(1).numpy()
    parts = np.split(fullpose, np.cumsum([3, 63, 3, 3, 3, 45]), axis=1)
    wrists = _wrists(subject, v_template, pose)
    tracks, components = {}, []
    for side, own in (("left", parts[5]), ("right", parts[6])):
        hand = subject.hand(side)
        basis, middle = hand.hands_components[:N_COMPS].double().numpy().T, hand.hands_mean.double().numpy()
        orient, at = wrists[side]
        tracks[side] = HandTrack(
            _single(orient), _single(own @ basis), _single(at), _single(own), subject.path(f"_{side[0]}hand")
        )
        components.append(_single((own - middle) @ basis))
    expression = np.zeros((n, 10))
    expression[:, : pose.shape.shape[1]] = pose.shape.numpy()
    transl = pose.transl.double().numpy()
    body = BodyTrack(
        _single(transl), *(_single(part) for part in parts[:5]), *components, _single(fullpose), _single(expression),
        subject.path(),
    )  # fmt: skip
    action = re.fullmatch(r".*?_(.+?)(?:_\d+)?", name.rpartition("/")[2])
    path = str(OBJECT_MESHES / f"{object_name}.ply")
    return Sequence(
        name=name,
        gender=subject.gender,
        sbj_id=subject.name,
        obj_name=object_name,
        motion_intent=action[1] if action else "use",
        framerate=rate,
        n_comps=N_COMPS,
        body=body,
        rhand=tracks["right"],
        lhand=tracks["left"],
        object=RigidTrack(np.zeros((n, 3), np.float32), np.zeros((n, 3), np.float32), path)
        if motion is None
        else RigidTrack(_single(motion.transl.numpy()), _single(-log(motion.rotations).numpy()), path),
        table=_table(n, motion, mesh),
        contact=ContactTrack(
            np.broadcast_to(np.uint8(0), (n, 0 if mesh is None else len(mesh.vertices))),
            np.broadcast_to(np.uint8(0), (n, len(v_template))),
        ),
    )


def _table(n: int, motion: RigidMotion | None, mesh: Mesh | None) -> RigidTrack:
    """A level top right under the object as it lies in the first frame: captures say nothing about tables."""
    transl = np.zeros((n, 3), np.float32)
    if motion is not None and mesh is not None:
        corners = mesh.vertices.astype(np.float64) @ motion.rotations[0].numpy().T + motion.transl[0].numpy()
        transl[:] = [*corners.mean(0)[:2], corners[:, 2].min()]
    return RigidTrack(transl, np.zeros((n, 3), np.float32), TABLE_MESH)


def _wrists(subject: Subject, v_template: Tensor, pose: Pose) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Of each side, how the hand is turned (T, 3) and its translation (T, 3), in the hand model's parameters."""
    body = subject.body
    joints, levels = body.rest_joints(v_template).double().unsqueeze(0), tree_levels(body.parents)
    turns: dict[str, list[Tensor]] = {"left": [], "right": []}
    places: dict[str, list[Tensor]] = {"left": [], "right": []}
    for start in range(0, len(pose.transl), _BATCH):
        now = pose.frames(slice(start, start + _BATCH))
        world, at = forward_kinematics(now.rotations.double(), joints, body.parents, levels)
        for side, hand in (("left", LEFT_HAND_JOINTS), ("right", RIGHT_HAND_JOINTS)):
            turns[side].append(log(world[:, hand[0]]))
            places[side].append(at[:, hand[0]] + now.transl.double() - subject.wrist_at_rest(side))
    return {side: (torch.cat(turns[side]).numpy(), torch.cat(places[side]).numpy()) for side in turns}


def _single(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, np.float32)
