from __future__ import annotations

import numpy as np

from grabnet.body.hand import HandModel
from grabnet.body.skeleton import (
    HEAD_PARTS,
    JOINTS,
    LEFT_HAND_JOINTS,
    LEFT_HAND_PARTS,
    MIRROR_JOINT,
    MIRRORED_PART,
    N_PARTS,
    PARENTS,
    PARTS,
    RIGHT_FINGER_PARTS,
    RIGHT_HAND_JOINTS,
    RIGHT_HAND_PARTS,
)
from tests.body.conftest import BODY_PARENTS


def test_parts_have_grabs_numbers():
    """As documented for the data set (ref. 1)."""
    assert N_PARTS == 55 and (PARTS["pelvis"], PARTS["head"], PARTS["jaw"], PARTS["neck"]) == (1, 16, 23, 13)
    assert (21, *range(26, 41)) == LEFT_HAND_PARTS and (22, *range(41, 56)) == RIGHT_HAND_PARTS
    assert RIGHT_FINGER_PARTS == {
        "index": (41, 42, 43),
        "middle": (44, 45, 46),
        "pinky": (47, 48, 49),
        "ring": (50, 51, 52),
        "thumb": (53, 54, 55),
    }
    assert [PARTS[f"left_{finger}1"] for finger in ("index", "middle", "pinky", "ring", "thumb")] == [
        26,
        29,
        32,
        35,
        38,
    ]
    assert HEAD_PARTS == (13, 16, 23, 24, 25)


def test_the_tree_is_the_body_models():
    assert (-1, *BODY_PARENTS[1:]) == PARENTS
    hand = HandModel.open().parents
    for joints in (LEFT_HAND_JOINTS, RIGHT_HAND_JOINTS):
        assert [PARENTS[joint] for joint in joints[1:]] == [joints[parent] for parent in hand[1:]]


def test_a_mirror_swaps_left_and_right():
    for joint, other in zip(JOINTS, MIRROR_JOINT, strict=True):
        sides = {joint.split("_")[0], JOINTS[other].split("_")[0]}
        assert sides == {"left", "right"} or (joint == JOINTS[other] and not sides & {"left", "right"})
    assert (MIRRORED_PART[MIRRORED_PART] == np.arange(N_PARTS + 1)).all() and MIRRORED_PART[0] == 0
    assert MIRRORED_PART[list(LEFT_HAND_PARTS)].tolist() == list(RIGHT_HAND_PARTS)
