"""Where objects are touched (paper 3.5, Fig. 5, 6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.comparing import compared, is_alike, minus
from grabnet.analysis.data_set import DataSet
from grabnet.analysis.frames import ALL, Frames, Subset
from grabnet.analysis.plots import difference_colours, heat_colours, tiled
from grabnet.analysis.statistic import Analysed, Heats, Row, Statistic
from grabnet.geometry.mesh import Mesh
from grabnet.visual.pictures import Shape, can_render, render_views

_SIZE = (150, 150)
_VIEWS = ((-0.45, -1.0, 0.45), (0.45, 1.0, 0.45))  # from the front, and from behind
_Column = tuple[str, str]  # data set and intent


class ObjectHeat(Statistic):
    """How often each vertex of each object is touched."""

    name = "object_heat"
    title = "Contact on objects"
    about = (
        "Likelihood that a vertex of an object is touched in a contact frame with it, by intent (paper Fig. 5, 6); "
        "from the front, and from behind."
    )
    by = ("intent", "object")

    def add(self, frames: Frames) -> None:
        contact = frames.contact_frames(self.rules.min_lift, self.rules.min_body_vertices)
        self.count(frames.group, "frames", contact.sum())
        self.count(frames.group, "vertices", np.count_nonzero(frames.object[contact], axis=0).astype(np.uint32))

    def share(self, subset: Subset, name: str) -> np.ndarray | None:
        """(V of the object,) likelihood among the contact frames of a subset with an object; None without any."""
        chosen = Subset(subset.intents, subset.subjects, [name])
        frames = self.total("frames", chosen)
        return self.total("vertices", chosen) / frames if frames else None

    def result(self, subset: Subset) -> list[Row]:
        rows = []
        for name in sorted({group.object for group in self.groups(subset)}):
            for intent, chosen in self.by_intent(Subset(subset.intents, subset.subjects, [name])):
                share = self.share(chosen, name)
                row: Row = {"object": name, "intent": intent, "contact frames": int(self.total("frames", chosen))}
                row["highest likelihood [%]"] = np.nan if share is None else 100 * float(share.max())
                rows.append(row | {"ever touched [%]": 0.0 if share is None else 100 * float((share > 0).mean())})
        return rows

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        if can_render():
            return None
        found = cls._shares(analysed)
        highest = max((float(share.max()) for shares in found.values() for share in shares.values()), default=0.0)
        if not highest:
            return None
        columns = list(dict.fromkeys(column for shares in found.values() for column in shares))
        pairs = compared(columns, lambda column: column)
        data = {each.label: each.data for each in analysed}
        changes = {name: _changes(shares, _meshes(data, name, shares), pairs) for name, shares in found.items()}
        pairs = [pair for pair in pairs if any(pair in of for of in changes.values())]
        most = max((float(np.abs(c).max()) for of in changes.values() for c in of.values()), default=0.0)
        tiles = []
        for name, shares in found.items():
            line = [_tile(data[c[0]], name, heat_colours(shares[c], highest)) if c in shares else None for c in columns]
            for pair in pairs:
                change = changes[name].get(pair)
                colours = None if change is None else difference_colours(change, most)
                line.append(None if colours is None else _tile(data[pair[0][0]], name, colours))
            tiles.append(line)
        heads = ["\n".join(column) for column in columns] + [minus(*pair).replace(", ", "\n") for pair in pairs]
        scales = [("likelihood of being touched, %", "heat", 0.0, 100 * highest)]
        if pairs and most:
            scales.append(("difference, percentage points", "difference", -100 * most, 100 * most))
        return tiled(tiles, list(found), heads, scales, size=2.3)

    @classmethod
    def heats(cls, analysed: Sequence[Analysed]) -> dict[str, Heats]:
        data, found = {each.label: each.data for each in analysed}, {}
        for name, shares in cls._shares(analysed).items():
            meshes = _meshes(data, name, shares)
            first = next(iter(meshes.values()))
            titles = {label: name if is_alike(mesh, first) else f"{name} of {label}" for label, mesh in meshes.items()}
            for (label, intent), share in shares.items():
                empty = Heats(meshes[label].vertices, meshes[label].faces, "z", {}, {})
                found.setdefault(titles[label], empty).shares[f"{label}, {intent}"] = share
            for pair, change in _changes(shares, meshes, compared(list(shares), lambda column: column)).items():
                found[titles[pair[0][0]]].changes[minus(*pair)] = change
        return found

    @classmethod
    def _shares(cls, analysed: Sequence[Analysed]) -> dict[str, dict[tuple[str, str], np.ndarray]]:
        """Likelihoods on each object that was touched, by label and intent."""
        found: dict[str, dict[tuple[str, str], np.ndarray]] = {}
        for each in analysed:
            heat = each.statistics[cls.name]
            for intent, chosen in heat.by_intent(ALL):
                for name in sorted({group.object for group in heat.groups(chosen)}):
                    if (share := heat.share(chosen, name)) is not None:
                        found.setdefault(name, {})[each.label, intent] = share
        return dict(sorted(found.items()))


def _meshes(data: Mapping[str, DataSet], name: str, shares: Mapping[_Column, np.ndarray]) -> dict[str, Mesh]:
    """An object's mesh in each data set that touches it, by label."""
    return {label: data[label].object_mesh(name) for label in dict.fromkeys(label for label, _ in shares)}


def _changes(
    shares: Mapping[_Column, np.ndarray], meshes: Mapping[str, Mesh], pairs: Sequence[tuple[_Column, _Column]]
) -> dict[tuple[_Column, _Column], np.ndarray]:
    """Differences of likelihoods by pair of columns; none of meshes that differ between data sets."""
    there = [(a, b) for a, b in pairs if a in shares and b in shares and is_alike(meshes[a[0]], meshes[b[0]])]
    return {(a, b): shares[a] - shares[b] for a, b in there}


def _tile(data: DataSet, name: str, colours: np.ndarray) -> np.ndarray:
    mesh = data.object_mesh(name)
    return np.concatenate(render_views([Shape(mesh.vertices, mesh.faces, colours)], _VIEWS, size=_SIZE), 1)
