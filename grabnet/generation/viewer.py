"""A single HTML page to turn grasps in 3-D: everything in the file, nothing fetched from anywhere."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np

from grabnet.generation.captions import caption
from grabnet.generation.grasps import Grasps
from grabnet.io.files import replacing
from grabnet.visual.pictures import OBJECT, SKIN

_TEMPLATE = Path(__file__).with_name("viewer.html")


def write_viewer(path: str | Path, grasps: Grasps, title: str) -> None:
    """Write the page for one object's grasps, atomically.

    Positions are stored in 16 bits over the box around all of them: 10 µm steps for a box of 65 cm.
    """
    hands, solid = grasps.vertices.numpy(), grasps.mesh.vertices
    low = np.minimum(hands.min((0, 1)), solid.min(0)).astype(np.float64)
    high = np.maximum(hands.max((0, 1)), solid.max(0)).astype(np.float64)
    step = float((high - low).max()) / 65535

    def positions(vertices: np.ndarray) -> str:
        return _base64(((vertices - low) / step).round().astype("<u2"))

    # 0 apart, 1 in contact, 2 inside
    touching = grasps.contacts.touching.int() + (grasps.contacts.distances < 0).int()
    data = {
        "title": title,
        "side": grasps.side,
        "contact_mm": round(1000 * grasps.contacts.contact_distance, 2),
        "low": low.tolist(),
        "step": step,
        "up": grasps.up.tolist(),
        "front": (-grasps.to_object[1, :3]).tolist(),
        "object": {
            "vertices": positions(solid),
            "faces": _base64(grasps.mesh.faces.astype("<u4")),
            "color": OBJECT,
        },
        "hand": {
            "vertices": positions(hands),
            "faces": _base64(grasps.faces.numpy().astype("<u4")),
            "touching": _base64(touching.numpy().astype("u1")),
            "color": SKIN,
        },
        "grasps": [record | {"caption": caption(record)} for record in grasps.report()],
    }
    # "<" must not end the script that holds the data, whatever the mesh is called.
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    with replacing(path) as temporary:
        temporary.write_text(_TEMPLATE.read_text(encoding="utf-8").replace("/*DATA*/", text), encoding="utf-8")


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(array.tobytes()).decode("ascii")
