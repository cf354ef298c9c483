"""The paper's four intents of GRAB's actions."""

from __future__ import annotations

import pytest

from grabnet.data.intents import action_of, intent_of


@pytest.mark.parametrize(
    ("action", "intent"),
    [
        ("drink", "use"),
        ("takepicture", "use"),
        ("use", "use"),
        ("pass", "pass"),
        ("lift", "lift"),
        ("offhand", "offhand"),
    ],
)
def test_all_but_three_actions_are_use(action, intent):
    assert intent_of(action) == intent


@pytest.mark.parametrize(
    ("name", "action"),
    [
        ("s1/mug_drink_1", "drink"),
        ("s10/cubelarge_offhand_2", "offhand"),
        ("s1/mug_drink_3_Retake", "drink"),
        ("s1/mug_lift_1_mirrored", "lift"),
        ("s1/clip", ""),
    ],
)
def test_the_action_stands_in_the_recordings_name(name, action):
    assert action_of(name) == action
