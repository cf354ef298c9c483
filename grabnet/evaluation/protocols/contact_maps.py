"""Contact of grasps with the object, annotated as the data set is (paper S.7): what touches what, vertex by vertex."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
import trimesh
from hydra.utils import instantiate

from grabnet.cli.progress import track
from grabnet.contact.hands import HandAnnotator
from grabnet.contact.rules import ContactRules
from grabnet.evaluation.colours import blended
from grabnet.evaluation.hands import HandLabels, Hands
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.methods import Method
from grabnet.evaluation.protocol import PerGrasp
from grabnet.evaluation.scene import GraspScene
from grabnet.geometry.mesh import Mesh
from grabnet.io.files import replacing, write_bytes
from grabnet.visual.pictures import OBJECT, SKIN
from grabnet.visual.scenes import glb


class ContactMaps(PerGrasp):
    """Which vertices of object and hand touch.

    object: (N, V of the object) uint8, the part of the hand that touches each vertex, 0 for none. hand: (N, V) uint8,
    the own part of each touching vertex, 0 for the others. Parts are numbered as in GRAB (ref. 1).

    Args:
        labels: of the hand model; hands of other vertices count as one part.
        distance: ε, metres (ref. 4: 4.5 mm).
        rules: what ε is measured to, and whose part it is.
    """

    name = "maps"
    highlight = "object"
    legend = "Red: contact, annotated as in the data set (paper S.7)."

    def __init__(self, labels: HandLabels, distance: float, rules: ContactRules = ContactRules()):  # noqa: B008, frozen
        self.labels = labels
        self.distance = distance
        self.rules = rules
        self.settings = f"{distance} {rules}"

    @classmethod
    def of(cls, inputs: EvaluationInputs) -> Self:
        return cls(inputs.labels, inputs.config.contact_distance, instantiate(inputs.config.contact))

    def __call__(self, scene: GraspScene) -> dict[str, np.ndarray]:
        hands, parts = scene.hands, self.labels.parts_of(scene.hands)
        annotate = scene.target.kept(
            ("annotator", hands.faces.tobytes(), parts.tobytes(), self.settings),
            lambda: HandAnnotator(
                scene.target.mesh,
                hands.vertices[0],
                hands.faces,
                parts,
                self.distance,
                self.rules,
                self.labels.bones if self.labels.fit(hands) else None,
            ),
        )
        return annotate(hands.vertices)._asdict()

    def write(self, folder: Path, methods: Sequence[Method], inputs: EvaluationInputs) -> None:
        """Write `contact/<method>/<object>…`, as `write_maps` does."""
        places: dict[str, Path] = {}  # of names that differ in other characters only, each its own
        for method in methods:
            plain = re.sub("[^a-z0-9]+", "_", method.name.lower()).strip("_") or "method"
            names = itertools.chain([plain], (f"{plain}_{k}" for k in itertools.count(2)))
            unique = next(name for name in names if name not in places)
            place = places[unique] = folder / "contact" / unique
            for name, hands in track(method.hands.items(), f"Writing contact of {method.name}"):
                maps = {node: method.results[name][f"maps/{node}"] for node in ("object", "hand")}
                write_maps(place, name, inputs.meshes[name], hands, maps, inputs.config.scenes)


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
        parts = {}
        for node, vertices, faces, base in (
            ("object", mesh.vertices, mesh.faces, OBJECT),
            ("hand", hands.vertices[i], hands.faces, SKIN),
        ):
            parts[node] = _coloured(vertices, faces, blended(base, maps[node][i] > 0))
            parts[node].vertex_attributes["_contact"] = maps[node][i].astype(np.float32)
        write_bytes(folder / f"{name}_{i:03d}.glb", glb(parts, np.eye(4)))


def _coloured(vertices: np.ndarray, faces: np.ndarray, colors: np.ndarray) -> trimesh.Trimesh:
    rgba = np.concatenate([255 * colors, np.full((len(colors), 1), 255)], 1).round().astype(np.uint8)
    return trimesh.Trimesh(vertices, faces, vertex_colors=rgba, process=False)
