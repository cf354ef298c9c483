"""Does the hand hold the object? Rigid bodies under gravity in MuJoCo: the hand stays still, the object is let go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from grabnet.geometry.mesh import Mesh
from grabnet.physics.simulation import Dynamics, RigidBody, Simulation, SimulationError

_GRAVITY = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class StabilityConfig:
    """What is simulated."""

    friction: float = 0.7  # dry skin on common materials is .5–1; the rigid press-fit of the hand is generous already
    mass: float = 0.15  # kg
    duration: float = 0.3  # seconds
    timestep: float = 0.003  # seconds
    max_displacement: float = 0.010  # metres that the object's centre of mass may move
    max_turn: float = 0.5  # radians
    cell: float = 0.016  # metres: the object's surface is cut into convex cells of this size …
    shell: float = 0.008  # … and at most this thickness
    near: float = 0.004  # metres: what is further from the other body is left out


def cut(mesh: Mesh, thickness: np.ndarray, config: StabilityConfig) -> RigidBody:
    """A closed mesh cut into convex cells by a lattice; within a cell's size hollows stay hollow.

    Convex decomposition (`grabnet.physics.decomposition`) gives fewer pieces, but takes a quarter of a minute an
    object and fills hollows as much.

    Args:
        thickness: (V,) metres of material behind each vertex.
    """
    solid = mesh.trimesh()
    properties = solid.mass_properties
    inertia = properties["inertia"] / properties["mass"]
    inner = mesh.vertices - solid.vertex_normals * np.minimum(thickness, config.shell)[:, None]
    if solid.convex_hull.volume < 1.02 * abs(mesh.volume):
        return RigidBody([np.asarray(solid.convex_hull.vertices)], properties["center_mass"], inertia)
    place = np.floor(solid.triangles_center / config.cell).astype(int)
    _, cell = np.unique(place, axis=0, return_inverse=True)
    cells = []
    for faces in np.split(mesh.faces[np.argsort(cell, kind="stable")], np.cumsum(np.bincount(cell))[:-1]):
        corners = np.unique(faces)
        points = np.concatenate([mesh.vertices[corners], inner[corners]]).astype(np.float64)
        try:
            cells.append(points[ConvexHull(points).vertices])
        except QhullError:  # flat: a sliver at a cell's border
            continue
    return RigidBody(cells, properties["center_mass"], inertia)


def displacement(held: RigidBody, hand_solids: list[np.ndarray], config: StabilityConfig) -> tuple[float, float]:
    """How far the object moves (metres) and turns (radians) when let go; infinite where it can't be simulated.

    Args:
        hand_solids: corners of the convex solids of the posed hand in the object's frame, z up, metres.
    """
    try:
        near = held.near(np.concatenate([np.empty((0, 3)), *hand_solids]), config.near)
        simulation = Simulation(near, hand_solids, Dynamics(config.friction, config.mass, config.timestep))
        steps = round(config.duration / config.timestep) - 1  # the last one's motion has never counted here
        return simulation.let_go(_GRAVITY, steps, config.max_displacement)
    except SimulationError:
        return np.inf, np.inf


def holds(held: RigidBody, hand_solids: list[np.ndarray], config: StabilityConfig) -> bool:
    """Whether the object stays in the hand."""
    moved, turned = displacement(held, hand_solids, config)
    return moved < config.max_displacement and turned < config.max_turn
