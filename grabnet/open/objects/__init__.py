"""Open stand-ins for the objects of GRAB: the same names and everyday sizes, every shape our own."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.open.objects import basic, household, kitchen, tools, toys
from grabnet.open.objects.isosurface import isosurface
from grabnet.open.objects.prop import Prop, Region

OBJECTS: dict[str, Callable[[], Prop]] = dict(
    sorted({**basic.PROPS, **household.PROPS, **kitchen.PROPS, **tools.PROPS, **toys.PROPS}.items())
)


@cache  # tables of outlines take a second to fill
def prop(name: str) -> Prop:
    """The object's solid, grasp regions and orientation; `UserError` for a name that is not in `OBJECTS`."""
    if name not in OBJECTS:
        raise UserError(f"There is no open object {name!r}; choose one of {', '.join(OBJECTS)}.")
    return OBJECTS[name]()


def build_object(name: str) -> Mesh:
    """Watertight mesh of an object: metres, z up, resting on z = 0, evenly meshed at about 2 mm."""
    built = prop(name)
    return Mesh(*isosurface(built.solid.distance, built.solid.low, built.solid.high, built.edge))


def grasp_regions(name: str) -> tuple[Region, ...]:
    """Where people take the object in use, in the mesh's frame; empty: anywhere."""
    return prop(name).regions
