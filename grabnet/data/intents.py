"""What recordings are about: GRAB names actions, and the paper groups them into four intents (Table 1; ref. 8)."""

from __future__ import annotations

from grabnet.data.splits import MIRRORED_SUFFIX

INTENTS = ("use", "pass", "lift", "offhand")


def intent_of(action: str) -> str:
    """Return the intent of an action, GRAB's `motion_intent`: pass, lift and offhand are their own, all else is use."""
    return action if action in INTENTS else "use"


def action_of(sequence: str) -> str:
    """Return the action in the name of a recording, `<subject>/<object>_<action>_<k>`; "" where there is none."""
    parts = sequence.removesuffix(MIRRORED_SUFFIX).rpartition("/")[2].split("_")
    return parts[1] if len(parts) > 1 else ""
