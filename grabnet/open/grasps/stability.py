"""Does the hand hold the object? Rigid bodies under gravity in MuJoCo: the hand stays still, the object is let go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from grabnet.body.anatomy import JOINTS
from grabnet.geometry.mesh import Mesh
from grabnet.open.grasps.posing import GraspHand

if TYPE_CHECKING:
    import mujoco


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


@dataclass(frozen=True)
class RigidObject:
    """An object for simulation: convex cells of its surface, each (N, 3) corners, and where its mass is.

    centre (3,) metres and inertia (3, 3) m², of 1 kg of the mesh's inside.
    """

    cells: list[np.ndarray]
    centre: np.ndarray
    inertia: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh, thickness: np.ndarray, config: StabilityConfig) -> RigidObject:
        """A closed mesh cut by a lattice; within a cell's size hollows stay hollow.

        Convex decomposition (coacd) gives fewer pieces, but takes up to a minute an object and fills hollows as much.

        Args:
            thickness: (V,) metres of material behind each vertex.
        """
        solid = mesh.trimesh()
        properties = solid.mass_properties
        inertia = properties["inertia"] / properties["mass"]
        inner = mesh.vertices - solid.vertex_normals * np.minimum(thickness, config.shell)[:, None]
        if solid.convex_hull.volume < 1.02 * abs(mesh.volume):
            return cls([np.asarray(solid.convex_hull.vertices)], properties["center_mass"], inertia)
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
        return cls(cells, properties["center_mass"], inertia)

    def near(self, points: np.ndarray, margin: float) -> list[np.ndarray]:
        """The cells with any of the points (N, 3) within `margin` of their box."""
        low = np.stack([cell.min(0) for cell in self.cells]) - margin
        high = np.stack([cell.max(0) for cell in self.cells]) + margin
        close = ((points > low[:, None]) & (points < high[:, None])).all(2).any(1)
        return [cell for cell, keep in zip(self.cells, close, strict=True) if keep]


def hand_pieces(hand: GraspHand) -> list[np.ndarray]:
    """Vertex sets whose convex hulls make up the hand: a phalanx each, and the palm in tiles."""
    weights, bone = hand.weights.numpy(), hand.anatomy.bone.numpy()
    pieces = [np.where((bone == j) | (weights[:, j] > 0.35))[0] for j in range(1, len(JOINTS))]
    palm = np.where(bone == 0)[0]
    x, z = hand.rest.numpy()[palm][:, [0, 2]].T
    overlap = 0.005
    for x0, x1 in zip(edges := np.linspace(x.min(), x.max(), 6), edges[1:], strict=False):
        for z0, z1 in zip(sides := np.linspace(z.min(), z.max(), 4), sides[1:], strict=False):
            tile = palm[(x >= x0 - overlap) & (x < x1 + overlap) & (z >= z0 - overlap) & (z < z1 + overlap)]
            if len(tile) >= 8:
                pieces.append(tile)
    return pieces


def displacement(held: RigidObject, hand_solids: list[np.ndarray], config: StabilityConfig) -> tuple[float, float]:
    """How far the object moves (metres) and turns (radians) when let go; infinite where it can't be simulated.

    Args:
        hand_solids: corners of the convex solids of the posed hand in the object's frame, z up, metres.
    """
    import mujoco  # here: an extra, which only building grasps needs

    spec = mujoco.MjSpec()
    spec.option.timestep = config.timestep
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint()
    body.explicitinertial, body.mass, body.ipos = True, config.mass, held.centre
    body.fullinertia = config.mass * held.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    friction = [config.friction, 0.02, 0.001]  # sliding; torsion and rolling in metres, of soft fingertips
    try:
        for i, cell in enumerate(held.near(np.concatenate(hand_solids), config.near)):
            _add(spec, body, f"object{i}", cell, friction, contype=1, conaffinity=2)
        for i, solid in enumerate(hand_solids):
            _add(spec, spec.worldbody, f"hand{i}", solid, friction, contype=2, conaffinity=1)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        start, orientation = data.xipos[1].copy(), data.xmat[1].reshape(3, 3).copy()
        moved = turned = 0.0
        for step in range(round(config.duration / config.timestep)):
            mujoco.mj_step(model, data)
            if step % 10 == 9:
                moved = float(np.linalg.norm(data.xipos[1] - start))
                cosine = (np.trace(orientation.T @ data.xmat[1].reshape(3, 3)) - 1) / 2
                turned = float(np.arccos(np.clip(cosine, -1, 1)))
                if not moved < config.max_displacement:
                    break
    except (ValueError, RuntimeError, mujoco.FatalError):
        return np.inf, np.inf
    if not np.isfinite(moved) or any(warning.number for warning in data.warning):
        return np.inf, np.inf
    return moved, turned


def holds(held: RigidObject, hand_solids: list[np.ndarray], config: StabilityConfig) -> bool:
    """Whether the object stays in the hand."""
    moved, turned = displacement(held, hand_solids, config)
    return moved < config.max_displacement and turned < config.max_turn


def _add(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, corners: np.ndarray, friction: list[float], **options: float
) -> None:
    import mujoco

    mesh = spec.add_mesh(name=name)
    mesh.uservert = np.asarray(corners, np.float32).ravel()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, friction=friction, condim=4, **options)
