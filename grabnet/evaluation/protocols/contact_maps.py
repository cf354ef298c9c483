"""Contact of grasps with the object, annotated as the data set is (paper S.7): what touches what, vertex by vertex."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from grabnet.contact.annotator import ContactAnnotator
from grabnet.evaluation.hands import HandLabels, Hands
from grabnet.evaluation.scene import Scene
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import replacing, write_bytes
from grabnet.visual.pictures import OBJECT, SKIN

TOUCHED = (0.86, 0.2, 0.15)


class ContactMaps:
    """Which vertices of object and hand touch.

    object: (N, V of the object) uint8, the part of the hand that touches each vertex, 0 for none. hand: (N, V) uint8,
    the own part of each touching vertex, 0 for the others. Parts are numbered as in GRAB (ref. 1).

    Args:
        labels: of the hand model; hands of other vertices count as one part.
        distance: ε, metres (ref. 4: 4.5 mm).
    """

    name = "maps"
    metrics = ()

    def __init__(self, labels: HandLabels, distance: float):
        self.labels, self.distance = labels, distance
        self.settings = f"{distance}"

    def __call__(self, scene: Scene) -> dict[str, np.ndarray]:
        parts = self.labels.parts_of(scene.hands)
        # The annotator's bodies are closed; what closes the wrist belongs to it.
        vertices, faces = scene.hands.closed
        closed_parts = np.append(parts, np.full(vertices.shape[1] - len(parts), parts.min(), np.uint8))
        annotator = scene.target.kept(
            ("annotator", faces.tobytes(), parts.tobytes(), self.distance),
            lambda: ContactAnnotator(scene.target.mesh, vertices[0], faces, closed_parts, self.distance),
        )
        found = [annotator(hand) for hand in vertices]
        return {
            "object": np.stack([f.object for f in found]),
            "hand": np.stack([f.body[: len(parts)] for f in found]),
        }


def write_maps(folder: Path, name: str, mesh: Mesh, hands: Hands, maps: dict[str, np.ndarray], scenes: int) -> None:
    """Write the contact of one object's grasps.

    <name>.npz: object (N, V of the object) and hand (N, V), as `ContactMaps` gives them, hand_vertices (N, V, 3) and
    hand_faces. <name>.ply: the object; its vertices have `contact`, the share of the grasps that touch there, and a
    colour from it. <name>_000.glb …: the first `scenes` grasps, nodes "object" and "hand", touching vertices red, with
    the parts as vertex attribute `_contact`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / f"{name}.npz") as temporary:
        np.savez_compressed(temporary, **maps, hand_vertices=hands.vertices, hand_faces=hands.faces)
    share = (maps["object"] > 0).mean(0, dtype=np.float64).astype(np.float32)
    solid = _coloured(mesh.vertices, mesh.faces, blended(OBJECT, share / max(share.max(), 1e-9)))
    solid.vertex_attributes["contact"] = share
    write_bytes(folder / f"{name}.ply", solid.export(file_type="ply"))
    for i in range(min(scenes, len(hands))):
        scene = trimesh.Scene()
        for node, vertices, faces, base in (
            ("object", mesh.vertices, mesh.faces, OBJECT),
            ("hand", hands.vertices[i], hands.faces, SKIN),
        ):
            part = _coloured(vertices, faces, blended(base, maps[node][i] > 0))
            part.vertex_attributes["_contact"] = maps[node][i].astype(np.float32)
            scene.add_geometry(part, node_name=node, geom_name=node)
        write_bytes(folder / f"{name}_{i:03d}.glb", scene.export(file_type="glb"))


def blended(base: tuple[float, float, float], share: np.ndarray) -> np.ndarray:
    """(V, 3) colours in [0, 1] from `base` where share (V,) is 0 to red where it is 1."""
    share = np.asarray(share, float)[:, None]
    return (1 - share) * np.array(base) + share * np.array(TOUCHED)


def _coloured(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray) -> trimesh.Trimesh:
    rgba = np.concatenate([255 * colors, np.full((len(colors), 1), 255)], 1).round().astype(np.uint8)
    return trimesh.Trimesh(vertices, faces, vertex_colors=rgba, process=False)
