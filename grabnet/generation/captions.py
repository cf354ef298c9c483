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
    touching = {part for part, count in record["contact_vertices"].items() if count}
    n = len(touching & set(FINGERS) - {"thumb"})
    fingers = [f"{n} finger{'s' * (n != 1)}"] * (n > 0)
    parts = ["thumb"] * ("thumb" in touching) + fingers + ["palm"] * ("palm" in touching)
    if not parts:
        held = "nothing touches"
    elif len(parts) == 1:
        held = f"only {'the ' * (not n)}{parts[0]} touch{'es' * (n < 2)}"
    else:
        how = "" if record["pierced"] else "held by " if record["opposition"] > _HOLDS else "pushed by "
        held = f"{how}{' + '.join(parts)}"
    if record["pierced"]:
        far = f"{record['through_mm']:.0f} mm " * (record["through_mm"] >= 0.5)
        return f"{held}, {far}through the object"
    wall = record["through_mm"] - record["max_penetration_mm"] > _WALL
    through = f", {record['through_mm']:.0f} mm through a wall" if wall else ""
    return f"{held}, {record['max_penetration_mm']:.1f} mm deep{through}"
