"""What an object is to the rest of the code: its solid, and where people take it.

Frame of every object: z up, standing or lying on the table plane z = 0 as it would, origin below its middle. A front
faces −y; long lying objects point along x, the end that is held at −x.
"""

from __future__ import annotations

from dataclasses import dataclass

from grabnet.open.objects.solid import Solid

Corner = tuple[float, float, float]


@dataclass(frozen=True)
class Region:
    """A part that people grasp: the surface inside an axis-aligned box of the object frame (metres).

    `weight` is the share of grasps in use that go there; an object's shares sum to at most 1, the rest go anywhere.
    """

    name: str
    low: Corner
    high: Corner
    weight: float


@dataclass(frozen=True)
class Prop:
    """An object.

    `upright`: using it keeps it about the way it stands (a full cup, not a hammer). `edge`: of its triangles,
    metres; the paper's contact rule counts vertices, which suits about 2 mm.
    """

    solid: Solid
    regions: tuple[Region, ...] = ()
    upright: bool = False
    edge: float = 0.002
