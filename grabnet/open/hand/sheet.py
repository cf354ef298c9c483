"""One picture to judge a hand model by: poses up to the limits of the joints, and shapes."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.body.anatomy import FINGERS, Anatomy
from grabnet.body.hand import HandModel, HandParameters
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.visual.pictures import SKIN, Shape, contact_sheet, render

# Direction towards the viewer and what points up, in the hand's frame.
_BACK, _PALM, _SIDE = ((0, 1, 0), (-1, 0, 0)), ((0, -1, 0), (-1, 0, 0)), ((0, 0, 1), (0, 1, 0))
_ACROSS = ((-0.6, 0.5, 0.8), (0, 1, 0))
_FIST = {"mcp_flexion": 1.5, "pip": 1.7, "dip": 1.0}
_POSES = {
    "fist": {f"{f}_{joint}": angle for f in FINGERS[1:] for joint, angle in _FIST.items()}
    | {"thumb_cmc_flexion": 0.4, "thumb_mcp": 0.3, "thumb_ip": 0.7},
    **{f: {f"{f}_mcp_flexion": 1.2, f"{f}_pip": 1.4, f"{f}_dip": 0.8} for f in FINGERS[1:]},
    "thumb": {"thumb_cmc_flexion": 0.3, "thumb_mcp": 0.8, "thumb_ip": 1.0},
    "thumb to little finger": {
        "thumb_cmc_flexion": 0.73, "thumb_cmc_abduction": 0.87, "thumb_cmc_twist": 0.6, "thumb_mcp": 0.65,
    },
}  # fmt: skip


def hand_sheet(hand: HandModel, size: tuple[int, int] = (152, 152), n_betas: int = 8) -> np.ndarray:
    """uint8 picture: flat, relaxed and fist from four sides; each finger flexed; the thumb opposed; betas at ±2.

    Tiles are framed each by itself, but the two hands of a beta share theirs: −2 on the left, +2 on the right.
    """
    anatomy = Anatomy.of(hand)
    tiles, captions = [], []

    def posed(hand_pose: torch.Tensor, rest: torch.Tensor | None = None) -> Shape:
        parameters = HandParameters(torch.eye(3)[None], hand_pose, torch.zeros(1, 3))
        return Shape(hand(parameters, rest).vertices[0], hand.faces, SKIN)

    def draw(shapes: list[Shape], view: tuple, caption: str) -> None:
        tiles.append(render(shapes, *view, size=size))
        captions.append(caption)

    def pose(angles: dict[str, float]) -> torch.Tensor:
        return anatomy.hand_pose(torch.tensor([[angles.get(name, 0.0) for name in anatomy.angle_names]]))

    flat = pose({})
    relaxed = axis_angle_to_matrix(hand.hands_mean.view(1, 15, 3))
    for caption, hand_pose in (("flat", flat), ("relaxed", relaxed), ("fist", pose(_POSES["fist"]))):
        for view in (_BACK, _PALM, _SIDE, _ACROSS):
            draw([posed(hand_pose)], view, caption)
    for caption, angles in list(_POSES.items())[1:]:
        for view in (_PALM, _ACROSS):
            draw([posed(pose(angles))], view, caption)
    for k in range(n_betas):
        low, high = (posed(flat, hand.shaped(beta * torch.eye(k + 1)[k])) for beta in (-2, 2))
        # Seen from the back, the right hand's thumb is on the left: −z is to the right.
        draw([low, high._replace(vertices=high.vertices - torch.tensor([0, 0, 0.16]))], _BACK, f"beta {k + 1}: -2, +2")
    return contact_sheet(tiles, captions, columns=8)
