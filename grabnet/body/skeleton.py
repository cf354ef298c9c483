"""The joints of MANO and SMPL-X by name, and GRAB's contact labels, which are numbered after them (ref. 1).

Joints count from 0. Part p of a contact label is what moves with SMPL-X's joint p - 1; label 0 is no contact.
"""

from __future__ import annotations

import numpy as np

MODEL_FINGERS = ("index", "middle", "pinky", "ring", "thumb")  # in the models' order of joints
# Joint k is the proximal end of phalanx k of its finger: index1 is the knuckle, thumb1 the base of the thumb (CMC).
HAND_JOINTS = ("wrist", *(f"{finger}{k}" for finger in MODEL_FINGERS for k in (1, 2, 3)))

_TRUNK = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "jaw", "left_eye", "right_eye",
)  # fmt: skip
JOINTS = (*_TRUNK, *(f"{side}_{joint}" for side in ("left", "right") for joint in HAND_JOINTS[1:]))
# The sixteen joints of each hand among the body's, in the order of HAND_JOINTS.
LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS = (
    tuple(JOINTS.index(f"{side}_{joint}") for joint in HAND_JOINTS) for side in ("left", "right")
)
# Of each joint, its parent; -1 for the pelvis.
PARENTS = (
    *(-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 15, 15, 15),
    *(
        hand[0 if k % 3 == 1 else k - 1]  # first joints of fingers hang on the wrist
        for hand in (LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS)
        for k in range(1, len(HAND_JOINTS))
    ),
)
# Of each joint, its mirror image: left for right.
MIRROR_JOINT = tuple(
    JOINTS.index(name.replace("left", "*").replace("right", "left").replace("*", "right")) for name in JOINTS
)

N_PARTS = len(JOINTS)
PARTS = {joint: number for number, joint in enumerate(JOINTS, 1)}
# The sixteen parts of each hand, the palm first, in the order of HAND_JOINTS.
LEFT_HAND_PARTS, RIGHT_HAND_PARTS = (
    tuple(joint + 1 for joint in hand) for hand in (LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS)
)
RIGHT_FINGER_PARTS = {finger: tuple(PARTS[f"right_{finger}{k}"] for k in (1, 2, 3)) for finger in MODEL_FINGERS}
HEAD_PARTS = tuple(PARTS[joint] for joint in ("neck", "head", "jaw", "left_eye", "right_eye"))
# Of each label 0 … 55, the label of the mirror image: labels of a recording seen in a mirror are MIRRORED_PART[labels].
MIRRORED_PART = np.array([0, *(joint + 1 for joint in MIRROR_JOINT)], np.uint8)
