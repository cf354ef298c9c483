from __future__ import annotations

import torch

from grabnet.geometry.rotations import about_z, random_rotations
from grabnet.grasping.proposing.posture import PostureConfig, discomfort

# Distal, palmar and radial as rows: a hand that at rest lies along x with its palm down, its thumb towards z.
FRAME = torch.tensor([[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]])


def rotation(forearm, palm) -> torch.Tensor:
    """Wrist rotation of a right hand from where the forearm points and where the palm faces."""
    x, y = torch.tensor(forearm), -torch.tensor(palm)
    return torch.stack([x, y, torch.linalg.cross(x, y)], 1)


def uneasy(turn: torch.Tensor, on_table: bool = True, forward=(0.0, 0.0, 0.0)) -> float:
    return float(discomfort(turn[None], FRAME, torch.tensor([on_table]), torch.tensor([forward]), PostureConfig()))


def test_hands_from_above_and_from_the_side_are_at_ease():
    assert uneasy(rotation((0.0, -0.6, 0.8), (0.0, -0.8, -0.6))) == 0  # reaching down, palm down
    assert uneasy(rotation((0.0, -1.0, 0.0), (-1.0, 0.0, 0.0))) == 0  # around a glass, thumb up


def test_hands_from_below_palm_up_or_thumb_down_are_not():
    assert uneasy(rotation((0.0, -0.6, -0.8), (0.0, 0.8, -0.6))) > 0.5  # from under the table
    assert uneasy(rotation((0.0, -1.0, 0.0), (0.0, 0.0, 1.0))) > 0.5  # palm up
    assert uneasy(rotation((0.0, -1.0, 0.0), (1.0, 0.0, 0.0))) > 0.5  # thumb down


def test_a_tools_head_is_on_the_thumbs_side():
    hand = rotation((0.0, -1.0, 0.0), (0.0, 0.0, -1.0))  # palm down, arm from the front: the right thumb points to -x
    assert uneasy(hand, forward=(-1.0, 0.0, 0.0)) == 0
    assert uneasy(hand, forward=(1.0, 0.0, 0.0)) > 1


def test_heading_does_not_matter():
    generator = torch.Generator().manual_seed(0)
    turn = random_rotations(50, generator)
    args = (torch.arange(50) % 2 == 0, torch.zeros(50, 3), PostureConfig())
    torch.testing.assert_close(
        discomfort(turn, FRAME, *args), discomfort(about_z(torch.tensor(1.0)) @ turn, FRAME, *args)
    )
