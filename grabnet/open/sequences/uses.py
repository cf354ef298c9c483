"""What each object is used for: the action's name, where it is brought, and how it is moved there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Use(NamedTuple):
    """action: as in the file's name. where: "front", or "mouth", "eyes" or "ear" of the head, which it then touches or
    nearly so. turn: rotation vector, radians, and shift: metres, of a to-and-fro of so many cycles (x to the left,
    y up, z ahead). upright: the object is kept about as it stands.
    """

    action: str
    where: str = "front"
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cycles: float = 1.0
    upright: bool = False


_INSPECT = Use("inspect", turn=(0.2, 0.55, 0.0))
_DRINK = Use("drink", "mouth", turn=(-0.35, 0, 0), cycles=0.5, upright=True)
_TILT = (0.0, 0.0, 0.6)
USES: dict[str, Use] = {
    "airplane": Use("fly", shift=(0.12, 0.05, 0.0), turn=(0, 0, 0.3), cycles=1.5),
    "alarmclock": Use("see"),
    "apple": Use("eat", "mouth"),
    "banana": Use("eat", "mouth"),
    "binoculars": Use("see", "eyes", upright=True),
    "bowl": Use("drink", "mouth", turn=(-0.25, 0, 0), cycles=0.5, upright=True),
    "camera": Use("takepicture", "eyes", upright=True),
    "cup": _DRINK,
    "doorknob": Use("turn", turn=(0, 0, 0.6), cycles=2),
    "duck": Use("play", shift=(0.06, 0.03, 0.04), cycles=2),
    "eyeglasses": Use("clean", turn=(0.3, 0, 0.2), cycles=2),
    "flashlight": Use("on", turn=(0.2, 0.35, 0), cycles=1.5),
    "flute": Use("play", "mouth"),
    "fryingpan": Use("cook", shift=(0, 0.03, 0.05), cycles=2.5, upright=True),
    "gamecontroller": Use("play", turn=(0.2, 0, 0.25), cycles=2),
    "hammer": Use("hammer", turn=(0.35, 0, 0), shift=(0, 0.05, 0), cycles=3),
    "headphones": Use("listen", "ear"),
    "knife": Use("chop", turn=(0.15, 0, 0), shift=(0, 0.05, 0.03), cycles=3),
    "lightbulb": Use("screw", turn=(0, 0.6, 0), cycles=2.5),
    "mug": _DRINK,
    "phone": Use("call", "ear"),
    "piggybank": Use("shake", shift=(0, 0.04, 0), cycles=3),
    "scissors": Use("cut", shift=(0, 0, 0.06), cycles=2),
    "stamp": Use("stamp", shift=(0, 0.06, 0), cycles=2),
    "stapler": Use("staple", shift=(0, 0.04, 0), cycles=2),
    "teapot": Use("pour", turn=_TILT, cycles=0.5, upright=True),
    "toothbrush": Use("brush", "mouth", shift=(0.025, 0, 0), cycles=3),
    "toothpaste": Use("squeeze", turn=(0.5, 0, 0), cycles=0.5),
    "train": Use("play", shift=(0.1, 0, 0.03), cycles=1.5),
    "waterbottle": _DRINK,
    "wineglass": _DRINK,
}


def use_of(name: str) -> Use:
    """The use of an object; objects without one of their own are looked at from several sides."""
    return USES.get(name, _INSPECT)


def tilt_of(use: Use) -> tuple[float, float]:
    """Spread (radians) of the object's tilt and heading while it is used."""
    return (0.1, 0.9) if use.upright else (0.5, 0.9)


def motion_of(use: Use, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation vector and shift of the to-and-fro, somewhat more or less of it."""
    return scale * np.array(use.turn), scale * np.array(use.shift)
