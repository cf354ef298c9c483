"""Comparing frames made of the published parameters with the vertices and BPS stored beside them (ref. 2)."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.cli.progress import steps
from grabnet.data.sources.release_geometry import Block, StoredGeometry
from grabnet.data.sources.release_names import FrameName
from grabnet.errors import UserError
from grabnet.geometry.queries import MeshQuery
from grabnet.io.files import write_json
from grabnet.io.state import Finite, Kind, read_json

_ANOTHER_HAND = "pass the model that the data were made with: hand_model=mano hand_model.path=<MANO_RIGHT.npz>"
_OTHER_MESHES = "pass the meshes that the data were made with: objects.dir=<GRAB's contact_meshes>"
_REMEDIES = {
    "verts_rhand": _ANOTHER_HAND,
    "verts_rhand_f": _ANOTHER_HAND,
    "verts_object": _OTHER_MESHES,
    "bps_object": f"{_OTHER_MESHES}; or the release's bps.npz is of other data",
}


class PosedFrames(NamedTuple):
    """N frames of a split as their parameters have them, in the release's world: x = R (v - middle) + transl.

    names: of the frames.
    hand, noisy: parameters of the hands; noisy is None where they are left out.
    rotations: (N, 3, 3) R, from the object meshes' axes to the world's, for column vectors.
    middle: (N, 3) metres, of the bounding box of the object's mesh, in the mesh's frame.
    transl: (N, 3) metres, where it is in the world.
    """

    names: Sequence[FrameName]
    hand: HandParameters
    noisy: HandParameters | None
    rotations: Tensor
    middle: Tensor
    transl: Tensor


class Comparison:
    """Measures how far stored geometry lies off what we make of the parameters.

    Args:
        hand: the hand model.
        rest: (V, 3) rest hand of each subject, by name, metres.
        query: distances to the mesh of an object, by name.
        basis: (P, 3) metres, the release's basis points; None where it has none.
    """

    def __init__(
        self,
        hand: HandModel,
        rest: Mapping[str, Tensor],
        query: Callable[[str], MeshQuery],
        basis: Tensor | None,
    ):
        self.hand, self.rest, self.query, self.basis = hand, rest, query, basis

    def off(self, frames: PosedFrames, block: Block) -> dict[str, Tensor]:
        """Distances (n, …) by which each array of a block of n frames is off, metres.

        Hand vertices: to those of our hand. Object points: to the mesh. BPS: between its distances and ours to the
        mesh, which are smaller by what lies between the 2048 points that the stored ones are to. Besides,
        `hand_to_object` (n, 1): from the mesh to the nearest vertex of our hand, small where hands and objects fit.
        """
        rows, arrays = block.rows, block.arrays
        rest = torch.stack([self.rest[frames.names[row].subject] for row in rows])
        vertices = self.hand(frames.hand.select(rows), rest).vertices
        off = {"hand_to_object": self.to_mesh(frames, rows, vertices).amin(1, keepdim=True)}
        if "verts_rhand" in arrays:
            off["verts_rhand"] = (vertices - arrays["verts_rhand"]).norm(dim=-1)
        if "verts_rhand_f" in arrays:
            noisy = self.hand(frames.noisy.select(rows), rest).vertices
            off["verts_rhand_f"] = (noisy - arrays["verts_rhand_f"]).norm(dim=-1)
        if "verts_object" in arrays:
            off["verts_object"] = self.to_mesh(frames, rows, arrays["verts_object"])
        if "bps_object" in arrays:
            ours = self.to_mesh(frames, rows, self.basis.expand(len(rows), -1, -1))
            off["bps_object"] = (ours - arrays["bps_object"]).abs()
        return off

    def to_mesh(self, frames: PosedFrames, rows: Tensor, points: Tensor) -> Tensor:
        """Distances (n, P) of points (n, P, 3) in the world to the objects of frames `rows`."""
        centred = (points - frames.transl[rows].unsqueeze(1)) @ frames.rotations[rows]
        local = centred + frames.middle[rows].unsqueeze(1)
        objects = np.array([frames.names[row].object for row in rows])
        distances = torch.empty(local.shape[:2])
        for name in np.unique(objects):
            shown = torch.as_tensor(objects == name)
            found = self.query(name).closest(local[shown].flatten(0, 1)).distance
            distances[shown] = found.unflatten(0, (-1, local.shape[1]))
        return distances

    def points_off(self, frames: PosedFrames, geometry: StoredGeometry, rows: Tensor) -> float:
        """Mean distance of the stored object points of frames `rows` (n,), ascending, to the meshes, metres."""
        blocks = geometry.blocks(rows, ["verts_object"])
        return torch.cat([self.off(frames, block)["verts_object"] for block in blocks]).mean().item()


def sample_rows(names: Sequence[FrameName], n: int, seed: Sequence[int]) -> Tensor:
    """(n,) rows chosen at random in turns from all pairs of subject and object; the first k are so, too, for any k."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(names))
    _, pair = np.unique([f"{names[row].subject}/{names[row].object}" for row in order], return_inverse=True)
    by_pair = np.argsort(pair, kind="stable")
    turn = np.empty(len(names), int)
    turn[by_pair] = np.arange(len(names)) - np.searchsorted(pair[by_pair], pair[by_pair])
    return torch.as_tensor(order[np.argsort(turn, kind="stable")[:n]])


def compare(
    comparison: Comparison,
    frames: PosedFrames,
    geometry: StoredGeometry,
    rows: Tensor,
    tolerance: Mapping[str, float],
    record: ComparisonRecord,
    split: str,
) -> None:
    """Compare frames `rows` (n,), ascending, with what is stored of them, from where the record leaves off.

    Args:
        tolerance: metres that a frame may be off on average, for each array.

    Raises:
        UserError: a frame is further off, or a file or array is missing or damaged.
    """
    done, names = record.frames(split), tuple(geometry.shapes)
    if done == len(rows):
        return
    with steps(f"Comparing with stored vertices ({split})", len(rows), done) as counted:
        for block in geometry.blocks(rows[done:], names):
            off = comparison.off(frames, block)
            for name in names:
                _refuse_far(geometry, block, name, off[name], tolerance[name])
            record.add(split, len(block.rows), off)
            counted.advance(len(block.rows))


def _refuse_far(geometry: StoredGeometry, block: Block, name: str, distances: Tensor, tolerance: float) -> None:
    worst = int(distances.mean(1).argmax())
    mean, largest = distances[worst].mean().item(), distances[worst].max().item()
    if not mean <= tolerance:
        raise UserError(
            f"{geometry.place(int(block.rows[worst]))}: its {name} lies {1e3 * mean:.1f} mm off what its parameters "
            f"give ({1e3 * largest:.1f} mm at most; on average {1e3 * tolerance:g} mm are tolerated): "
            f"{_REMEDIES[name]}."
        )


_FOUND: Kind = {"frames": Finite(1), "arrays": {str: {"sum": Finite(0), "max": Finite(0)}}}
_RECORD: Kind = {"recipe": {str: object}, "turns_rows?": (bool, None), "splits": {str: _FOUND}}


class ComparisonRecord:
    """How far the comparison has come and what it found, on disk, so that a killed one goes on.

    Args:
        path: of its file.
        recipe: JSON-able, of all that the findings depend on; a record of another recipe is started again.

    Raises:
        UserError: the file is damaged.
    """

    def __init__(self, path: Path, recipe: Mapping[str, Any]):
        self.path = path
        self._content: dict[str, Any] = {"recipe": json.loads(json.dumps(recipe)), "splits": {}}
        if path.exists():
            stored = read_json(path, _RECORD, "delete it")
            self._content = stored if stored["recipe"] == self._content["recipe"] else self._content

    def frames(self, split: str) -> int:
        """How many frames of a split have been compared."""
        return self._content["splits"].get(split, {"frames": 0})["frames"]

    @property
    def turns_rows(self) -> bool | None:
        """Whether the objects' rotations are for row vectors; None where that was not found out yet."""
        return self._content.get("turns_rows")

    @turns_rows.setter
    def turns_rows(self, value: bool) -> None:
        self._content["turns_rows"] = value
        write_json(self.path, self._content)

    def add(self, split: str, n: int, off: Mapping[str, Tensor]) -> None:
        """Keep what was found of the next n frames of a split."""
        found = self._content["splits"].setdefault(split, {"frames": 0, "arrays": {}})
        for name, distances in off.items():
            kept = found["arrays"].setdefault(name, {"sum": 0.0, "max": 0.0})
            kept["sum"] += distances.mean(1).double().sum().item()
            kept["max"] = max(kept["max"], distances.max().item())
        found["frames"] += n
        write_json(self.path, self._content)

    def millimetres(self) -> dict[str, dict[str, Any]]:
        """By split: the number of frames compared, and of each array by how much they differ, mean and max."""
        return {
            split: {
                "frames": found["frames"],
                "off": {
                    name: {"mean_mm": 1e3 * off["sum"] / found["frames"], "max_mm": 1e3 * off["max"]}
                    for name, off in found["arrays"].items()
                },
            }
            for split, found in self._content["splits"].items()
        }
