"""From a performance to a sequence in GRAB's format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from grabnet.body.hand import HandModel
from grabnet.body.skeleton import JOINTS, LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import BodyTrack, ContactTrack, HandTrack, RigidTrack, Sequence
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.open.sequences.actor import SIDES
from grabnet.open.sequences.motion import Pose
from grabnet.open.sequences.performance import FRAMERATE, Performance
from grabnet.open.sequences.props import UP
from grabnet.open.sequences.setting import TABLE_SIZE, Table

TABLE_MESH = "tools/table_meshes/table.ply"  # "table" among the objects is a toy
# Principal components of a hand pose. GRAB has 24; the open poses span 25 dimensions, and the last of them moves
# fingers by up to 5 mm.
N_COMPS = 25


def to_sequence(
    stage: Performance, table: Table, name: str, object_name: str, action: str, heading: float, spot: np.ndarray
) -> Sequence:
    """Return the recording, without contact.

    Args:
        stage: what happens.
        table: where.
        name: of the recording.
        object_name: the object's.
        action: what is done, as in "drink" or "lift": GRAB's `motion_intent`.
        heading: radians by which the person is turned about the vertical.
        spot: (2,) metres, where the person stands.
    """
    actor, subject = stage.actor, stage.actor.subject
    world = Rotation.from_rotvec([0, 0, heading]).as_matrix() @ UP.T
    offset = np.array([*spot, 0.0]) - world @ [0, actor.floor, 0]
    room = Pose(world, offset)

    trunk = actor.trunk(np.concatenate(stage.trunk))
    n = len(trunk.transl)
    rotations = np.tile(np.eye(3), (n, len(JOINTS), 1, 1))
    for joint, turned in trunk.rotations.items():
        rotations[:, JOINTS.index(joint)] = turned
    rotations[:, 0] = world @ rotations[:, 0]
    hands = {}
    for side in SIDES:
        arm, fingers = np.concatenate(stage.arms[side]), actor.finger_pose(side, np.concatenate(stage.fingers[side]))
        wrist = trunk.chest
        above = "spine3"
        for k, joint in enumerate(("shoulder", "elbow", "wrist")):
            rotations[:, JOINTS.index(f"{side}_{joint}")] = arm[:, k]
            here = actor.joints[JOINTS.index(f"{side}_{joint}")] - actor.joints[JOINTS.index(above)]
            wrist = wrist @ Pose(arm[:, k], here)
            above = f"{side}_{joint}"
        hands[side] = room @ wrist, fingers
    fullpose = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_rotvec().reshape(n, 165)
    tracks = {}
    for side, first in (("left", LEFT_HAND_JOINTS[1]), ("right", RIGHT_HAND_JOINTS[1])):
        wrist, fingers = hands[side]
        fullpose[:, 3 * first : 3 * first + 45] = fingers
        origin = actor.hand_wrist * (1 if side == "right" else (-1, 1, 1))
        tracks[side] = HandTrack(
            _single(Rotation.from_matrix(wrist.rotation).as_rotvec()),
            _components(fingers, side, about_mean=False),
            _single(wrist.position - origin),
            _single(fingers),
            subject.file(f"_{side[0]}hand"),
        )
    origin = actor.joints[0]
    parts = np.split(fullpose, np.cumsum([3, 63, 3, 3, 3]), axis=1)
    body = BodyTrack(
        _single(room.points((origin + trunk.transl)[None])[0] - origin),
        *(_single(part) for part in parts[:5]),
        *(_components(hands[side][1], side, about_mean=True) for side in ("left", "right")),
        _single(fullpose),
        np.zeros((n, 10), np.float32),
        subject.file(),
    )
    things = Pose(
        np.concatenate([t.rotation for t in stage.things]), np.concatenate([t.position for t in stage.things])
    )
    middle = Pose(np.tile(UP, (n, 1, 1)), np.tile(table.centre, (n, 1)))
    return Sequence(
        name=name,
        gender=subject.gender,
        sbj_id=subject.name,
        obj_name=object_name,
        motion_intent=action,
        framerate=float(FRAMERATE),
        n_comps=N_COMPS,
        body=body,
        rhand=tracks["right"],
        lhand=tracks["left"],
        object=_rigid(room @ things, str(OBJECT_MESHES / f"{object_name}.ply")),
        table=_rigid(room @ middle, TABLE_MESH),
        contact=ContactTrack(np.zeros((n, 0), np.uint8), np.zeros((n, 0), np.uint8)),
    )


def write_table(root: Path) -> None:
    """Write the table top, its upper side in the plane z = 0."""
    width, thickness, depth = TABLE_SIZE
    top = trimesh.creation.box((width, depth, thickness))
    top.apply_translation((0, 0, -thickness / 2))
    path = root / TABLE_MESH
    path.parent.mkdir(parents=True, exist_ok=True)
    save_mesh(path, Mesh(np.asarray(top.vertices, np.float32), np.asarray(top.faces)))


def _rigid(pose: Pose, mesh: str) -> RigidTrack:
    """Stored rotations act on row vectors: they are the inverses."""
    return RigidTrack(_single(pose.position), _single(-Rotation.from_matrix(pose.rotation).as_rotvec()), mesh)


def _components(fingers: np.ndarray, side: str, about_mean: bool) -> np.ndarray:
    """(T, 45) axis-angle → (T, N_COMPS) principal components of the open hand (ref. 1).

    Args:
        fingers: poses.
        side: left or right.
        about_mean: count from the model's mean hand, as the whole body's are; from the flat hand otherwise.
    """
    hand = HandModel.open(side)
    offset = fingers - hand.hands_mean.double().numpy() if about_mean else fingers
    return _single(offset @ hand.hands_components[:N_COMPS].double().numpy().T)


def _single(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array, np.float32)
