"""The MakeHuman bones that SMPL-X's joints stand for."""

from __future__ import annotations

import numpy as np

from grabnet.body.skeleton import JOINTS

_FINGER_NUMBERS = {"thumb": 1, "index": 2, "middle": 3, "ring": 4, "pinky": 5}  # MakeHuman's
_CENTRAL = {
    "pelvis": "spine05", "spine1": "spine04", "spine2": "spine03", "spine3": "spine02", "neck": "neck01",
    "head": "head", "jaw": "jaw",
}  # fmt: skip
_LATERAL = {
    "hip": "upperleg01", "knee": "lowerleg01", "ankle": "foot", "foot": "toe3-1", "collar": "clavicle",
    "shoulder": "upperarm01", "elbow": "lowerarm01", "wrist": "wrist", "eye": "eye",
}  # fmt: skip
_TOES = tuple(f"toe{k}-1" for k in (1, 2, 4, 5))


def bone_of(joint: str) -> str:
    """The bone whose head a joint is."""
    if joint in _CENTRAL:
        return _CENTRAL[joint]
    side, name = joint.split("_")
    if name in _LATERAL:
        return f"{_LATERAL[name]}.{side[0].upper()}"
    return f"finger{_FINGER_NUMBERS[name[:-1]]}-{name[-1]}.{side[0].upper()}"


def merged_weights(weights: np.ndarray, bones: list[str], parents: list[int]) -> np.ndarray:
    """(V, B) weights of the bones → (V, 55) of the joints, each bone counted to the nearest joint above it."""
    owner = {bones.index(bone_of(joint)): j for j, joint in enumerate(JOINTS)}
    owner |= {bones.index(f"{toe}.{side}"): JOINTS.index(f"{name}_foot") for toe in _TOES
              for side, name in (("L", "left"), ("R", "right"))}  # fmt: skip
    merged = np.zeros((len(weights), len(JOINTS)))
    for bone in range(len(bones)):
        above = bone
        while above >= 0 and above not in owner:
            above = parents[above]
        merged[:, owner.get(above, 0)] += weights[:, bone]
    return merged
