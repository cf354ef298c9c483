"""A grasp in a few words, as pictures and the page show it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from grabnet.body.anatomy import FINGERS

# Of `opposition`: less is a push from one side.
_HOLDS = 0.2
# Millimetres by which skin is farther through than in: less is how pressed skin lies over an edge.
_WALL = 3.0


def caption(record: Mapping[str, Any]) -> str:
    """What a person would want to know of a grasp: what holds it, how deep it is, whether it goes through the object.

    Args:
        record: of `Grasps.report`.
    """
    touching = [finger for finger in FINGERS if record["contact_vertices"][finger]]
    n = len(touching) - ("thumb" in touching)  # without the thumb
    fingers = f"{n} finger{'s' * (n != 1)}"
    if not touching:
        held = "only the palm touches" if record["contact_vertices"]["palm"] else "nothing touches"
    elif touching == ["thumb"]:
        held = "only the thumb touches"
    elif "thumb" not in touching:
        held = f"{fingers}, no thumb"
    else:
        how = "" if record["pierced"] else "held by " if record["opposition"] > _HOLDS else "pushed by "
        held = f"{how}thumb + {fingers}"
    if record["pierced"]:
        return f"{held}, {record['through_mm']:.0f} mm through the object"
    wall = record["through_mm"] - record["max_penetration_mm"] > _WALL
    through = f", {record['through_mm']:.0f} mm through a wall" if wall else ""
    return f"{held}, {record['max_penetration_mm']:.1f} mm deep{through}"
