from __future__ import annotations

import pytest

from grabnet.body.anatomy import FINGERS
from grabnet.generation.captions import caption


def record(*touching: str, **measures: float) -> dict:
    counts = {part: 3 * (part in touching) for part in (*FINGERS, "palm")}
    values = {"max_penetration_mm": 1.24, "through_mm": 1.9, "pierced": False, "opposition": 0.9}
    return values | measures | {"contact_vertices": counts}


@pytest.mark.parametrize(
    ("of", "words"),
    [
        (record("thumb", "index", "ring", "palm"), "held by thumb + 2 fingers + palm, 1.2 mm deep"),
        (record("thumb", "pinky", opposition=-0.4), "pushed by thumb + 1 finger, 1.2 mm deep"),
        (record("thumb", "index", through_mm=8.3), "held by thumb + 1 finger, 1.2 mm deep, 8 mm through a wall"),
        (record("thumb", "index", through_mm=8.3, pierced=True), "thumb + 1 finger, 8 mm through the object"),
        (record("index", "middle", max_penetration_mm=0.0), "only 2 fingers touch, 0.0 mm deep"),
        (record("thumb"), "only the thumb touches, 1.2 mm deep"),
        (record("thumb", "palm"), "held by thumb + palm, 1.2 mm deep"),
        (record("index", pierced=True, through_mm=0.3), "only 1 finger touches, through the object"),
        (record("palm"), "only the palm touches, 1.2 mm deep"),
        (record(max_penetration_mm=0.0, through_mm=0.0), "nothing touches, 0.0 mm deep"),
    ],
)
def test_a_grasp_in_words(of, words):
    assert caption(of) == words


def test_no_depth_without_a_word_on_walls():
    """Depth alone is for grasps that go through nothing."""
    for through in (0.0, 4.0, 20.0):
        for pierced in (False, True):
            text = caption(record("thumb", "index", max_penetration_mm=0.3, through_mm=through, pierced=pierced))
            assert ("through" in text) == (pierced or through > 3.5)
