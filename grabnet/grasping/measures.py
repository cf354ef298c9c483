"""What grasps of one object are like, beyond the depth of their vertices: walls, bones, area, opposition, posture."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from grabnet.body.anatomy import vertex_normals
from grabnet.contact.contacts import Contacts
from grabnet.geometry.intersections import MovingMesh
from grabnet.geometry.mesh import Mesh, vertex_areas
from grabnet.geometry.openings import Lids
from grabnet.geometry.queries import MeshQuery
from grabnet.grasping.grasp_hand import GraspHand
from grabnet.grasping.interior import Interior
from grabnet.grasping.joints import beyond_limits
from grabnet.grasping.lines import Lines
from grabnet.grasping.opposition import opposition
from grabnet.grasping.pieces import count_pieces
from grabnet.grasping.walls import crossing

_NEAR = 0.005  # metres, as contact counts in the field (ref. 9)

# What the numbers of a report are, kept beside them.
DEFINITIONS = {
    "through_mm": "of the lines from inside a finger or the palm to each vertex of its skin, the longest stretch "
    "beyond where one first enters the object: depth through walls, however thin",
    "pierced": "whether the object cuts the hand into more than one piece, slivers within 0.2 mm of it apart, or "
    "touches the lines along its bones",
    "skin_contact_cm2": "skin within 5 mm of the object's surface, in or out, that looks against it",
    "opposition": "minus the cosine between the object's normals under the thumb and under the finger or palm that "
    "opposes it best: 1 opposite, 0 at right angles or where one of them touches nothing, -1 side by side",
    "crossing_mm": "how far one finger is inside another, or in the palm beyond 2 mm",
    "joint_excess_deg": "largest angle of a joint beyond its limit",
}


@dataclass(frozen=True, eq=False, kw_only=True)
class GraspMeasures:
    """Of N grasps, on the CPU; `DEFINITIONS` says what each is.

    Attributes:
        through_mm, skin_contact_cm2, opposition, crossing_mm, joint_excess_deg: (N,) finite.
        pierced: (N,) bool.
    """

    through_mm: Tensor
    pierced: Tensor
    skin_contact_cm2: Tensor
    opposition: Tensor
    crossing_mm: Tensor
    joint_excess_deg: Tensor

    def __len__(self) -> int:
        return len(self.pierced)

    def select(self, index: Tensor | slice) -> GraspMeasures:
        """The chosen grasps."""
        return replace(self, **{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def report(self) -> list[dict[str, float | bool]]:
        """One record per grasp, ready for JSON."""
        names = [f.name for f in fields(self)]
        rows = zip(*(getattr(self, name).tolist() for name in names), strict=True)
        return [{k: v if isinstance(v, bool) else round(v, 3) for k, v in zip(names, r, strict=True)} for r in rows]


@torch.no_grad()
def measure_grasps(
    hand: GraspHand,
    mesh: Mesh,
    vertices: Tensor,
    faces: Tensor,
    hand_pose: Tensor,
    contacts: Contacts,
) -> GraspMeasures:
    """Measure grasps as they are; all tensors on the CPU.

    Args:
        hand: of the hands' model, in any shape of it.
        mesh: the object, metres.
        vertices: (N, V, 3) metres, in its frame: hands of that model, or mirror images of such.
        faces: (F, 3) of the hands, facing outwards: of mirror images turned round.
        hand_pose: (N, 15, 3, 3) rotations of that model's joints; for mirror images those of the hand in the mirror.
        contacts: of the same hands with the object.
    """
    query = MeshQuery(mesh)
    interior = Interior.of(hand)
    lines = Lines.of(interior, query, vertices, contacts.distances)
    near = contacts.distances.abs() < _NEAR
    nearest = near | contacts.touching
    normals = torch.zeros_like(vertices)
    normals[nearest] = _normals(mesh)[query.closest(vertices[nearest]).face]
    against = near & ((vertex_normals(vertices, faces) * normals).sum(-1) < 0)
    areas = torch.from_numpy(vertex_areas(vertices.numpy(), faces.numpy()))
    pierced = lines.bone_crosses
    rest = ~pierced  # the others need no counting
    pierced[rest] = pieces(mesh, query, vertices[rest], faces, contacts.distances[rest], lines.select(rest)) > 1
    excess, _ = beyond_limits(hand.anatomy, hand_pose)
    return GraspMeasures(
        through_mm=1e3 * lines.through.amax(1),
        pierced=pierced,
        skin_contact_cm2=1e4 * (areas * against).sum(1).float(),
        opposition=opposition(contacts.touching, normals, contacts.finger),
        crossing_mm=crossing(hand, interior.posed(vertices)).clamp_min(0),
        joint_excess_deg=excess.amax(1),
    )


def pieces(
    mesh: Mesh, query: MeshQuery, vertices: Tensor, faces: Tensor, distances: Tensor, lines: Lines | None
) -> Tensor:
    """(N,) int64: into how many pieces an object cuts each hand, its wrist closed by a lid.

    Args:
        mesh: the object, closed or open. query: of the same, on the CPU.
        vertices: (N, V, 3) of the hands. faces: (F, 3), facing outwards.
        distances: (N, V) metres, signed, from the vertices to it.
        lines: in the hands; None where their bones are unknown.
    """
    if not len(vertices):
        return torch.zeros(0, dtype=torch.int64)
    lids = Lids(vertices.shape[1], faces.numpy())
    closed = torch.from_numpy(lids.with_middles(vertices.numpy()))
    middles = closed[:, vertices.shape[1] :]
    of_lids = query.signed_distance(middles.flatten(0, 1)).view(middles.shape[:2])
    distances = torch.cat([distances, of_lids.to(distances)], 1).numpy()
    hand = MovingMesh(closed[0].numpy(), np.concatenate([faces.numpy(), lids.faces]))
    solid = MovingMesh(mesh.vertices, mesh.faces if mesh.volume >= 0 else mesh.faces[:, ::-1])
    none = np.zeros((0, 2), np.int64)
    joined = [none] * len(closed) if lines is None else lines.joined(closed.shape[1])
    counts = []
    for posed, to_object, links in zip(closed.numpy(), distances, joined, strict=True):
        hand.move(posed)
        counts.append(count_pieces(hand, solid, to_object, links))
    return torch.tensor(counts)


def _normals(mesh: Mesh) -> Tensor:
    """(F, 3) outward unit normals of an object's faces."""
    a, b, c = torch.from_numpy(mesh.triangles).unbind(1)
    return normalize(torch.linalg.cross(b - a, c - a), dim=-1) * (1 if mesh.volume >= 0 else -1)
