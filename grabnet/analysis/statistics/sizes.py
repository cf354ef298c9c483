"""What the size of object and hand changes (paper S.12, Fig. S.12)."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.data_set import DataSet
from grabnet.analysis.frames import ALL, Frames, Subset
from grabnet.analysis.plots import bars, heat_colours, legend, panels, tiled
from grabnet.analysis.statistic import Analysed, Row, Statistic
from grabnet.analysis.statistics.shares import ContactShares
from grabnet.analysis.views import VIEWS, on_view, tile
from grabnet.visual.pictures import Shape, can_render, render

SHAPES, SIZES = ("cube", "cylinder", "pyramid", "sphere", "torus"), ("small", "medium", "large")
# Shape and size of each object of these.
PRIMITIVES = {shape + size: (shape, size) for shape in SHAPES for size in SIZES}
_HANDS = ("right palm", "left palm")
_TILE = (120, 120)


class _BySize(Statistic):
    """Counts of primitive shapes only, with the length of the subjects' hands."""

    by = ("subject", "object")

    def add(self, frames: Frames) -> None:
        if frames.group.object in PRIMITIVES:
            self.count(frames.group, "hand", np.array([frames.hand_length, 1.0]))
            self.add_primitive(frames)

    @abstractmethod
    def add_primitive(self, frames: Frames) -> None:
        """Count the frames of a primitive shape."""

    def who(self, subset: Subset) -> dict[str, Subset]:
        """All subjects; then, of several, those with the smallest and the biggest hand."""
        subjects = {group.subject for group in self.groups(subset)}
        sums = {name: self.total("hand", Subset(subjects=[name])) for name in subjects}
        hands = {name: float(length / n) for name, (length, n) in sums.items()}
        chosen = {"all": subset} if hands else {}
        if len(hands) > 1:
            by_size = sorted(hands, key=lambda name: (hands[name], name))
            for word, name in (("smallest", by_size[0]), ("biggest", by_size[-1])):
                title = f"{word} hand ({name}, {1000 * hands[name]:.0f} mm)"
                chosen[title] = Subset(subset.intents, [name], subset.objects)
        return chosen

    def primitives(self, subset: Subset) -> Iterator[tuple[Row, str, Subset]]:
        """Start of a row, object and subset for each of `who` and each primitive shape that they held."""
        for subjects, chosen in self.who(subset).items():
            there = {group.object for group in self.groups(chosen)}
            for name, (shape, size) in PRIMITIVES.items():
                if name in there:
                    row = {"subjects": subjects, "shape": shape, "size": size}
                    yield row, name, Subset(chosen.intents, chosen.subjects, [name])


class SizeEffect(_BySize, ContactShares):
    """Contact by size of the object and of the hand, for the primitive shapes."""

    name = "sizes"
    title = "Size of object and hand"
    about = (
        "Who touches, for the five primitive shapes by their size, of all subjects and of those with the smallest and "
        "the biggest hand (paper S.12)."
    )

    def add_primitive(self, frames: Frames) -> None:
        ContactShares.add(self, frames)

    def result(self, subset: Subset) -> list[Row]:
        return [row | self.shares(chosen) for row, _, chosen in self.primitives(subset)]

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        lines = []
        for each in analysed:
            rows = each.rows(cls)
            for subjects in dict.fromkeys(row["subjects"] for row in rows):
                lines.append((each.label, subjects, [row for row in rows if row["subjects"] == subjects]))
        if not lines:
            return None
        figure, axes = panels(len(lines), len(SHAPES), 2.2, 2.1)
        for line, (label, subjects, rows) in zip(axes, lines, strict=True):
            for here, shape in zip(line, SHAPES, strict=True):
                found = {row["size"]: row for row in rows if row["shape"] == shape}
                series = {
                    who: [found[size][f"{who} [%]"] if size in found else np.nan for size in SIZES]
                    for who in ("right hand", "left hand", "both hands")
                }
                bars(here, SIZES, series, f"{label}\n{subjects}\n% of contact frames" if shape == SHAPES[0] else "")
                here.set_ylim(0, 119)
                here.set_title(shape, fontsize=9)
                if not found:
                    here.text(0.5, 0.5, "none", transform=here.transAxes, ha="center", color="#98a2ad", fontsize=8)
        legend(figure, axes[0, 0])
        return figure


class SizeHeat(_BySize):
    """Where the primitive shapes and the hands that hold them are touched."""

    name = "size_heat"
    title = "Heatmaps by size of object and hand"
    about = (
        "Likelihood of contact over the contact frames with each primitive shape, on the object and on both hands, of "
        "all subjects and of those with the smallest and the biggest hand (paper S.12, Fig. S.12)."
    )

    def add_primitive(self, frames: Frames) -> None:
        contact = frames.contact_frames(self.rules.min_lift, self.rules.min_body_vertices)
        self.count(frames.group, "frames", contact.sum())
        self.count(frames.group, "object", np.count_nonzero(frames.object[contact], axis=0).astype(np.uint32))
        self.count(frames.group, "body", np.count_nonzero(frames.body[contact], axis=0).astype(np.uint32))

    def share(self, subset: Subset, of: str) -> np.ndarray | None:
        """(V,) likelihood on the "object" or "body" over the contact frames of a subset; None without any."""
        frames = self.total("frames", subset)
        return self.total(of, subset) / frames if frames else None

    def result(self, subset: Subset) -> list[Row]:
        rows = []
        for row, _, chosen in self.primitives(subset):
            row["contact frames"] = int(self.total("frames", chosen))
            for of in ("object", "body"):
                share = self.share(chosen, of)
                row[f"{of}, ever touched [%]"] = np.nan if share is None else 100 * float((share > 0).mean())
            rows.append(row)
        return rows

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        if can_render():
            return None
        lines: dict[str, dict[str, tuple[DataSet, str, np.ndarray]]] = {}
        for each in analysed:
            statistic = each.statistics[cls.name]
            for row, name, chosen in statistic.primitives(ALL):
                start = f"{each.label}\n{row['subjects']}"
                if (share := statistic.share(chosen, "object")) is not None:
                    lines.setdefault(start, {})[name] = each.data, "object", share
                    touched = statistic.share(chosen, "body")
                    for view in _HANDS:
                        if touched[on_view(each.data.surface, view)].any():
                            lines.setdefault(f"{start}\n{view}", {})[name] = each.data, view, touched
        columns = [name for name in PRIMITIVES if any(name in line for line in lines.values())]
        shown = [
            share if what == "object" else share[on_view(data.surface, what)]
            for line in lines.values() for data, what, share in line.values()
        ]  # fmt: skip
        highest = max((float(share.max()) for share in shown), default=0.0)
        if not highest:
            return None
        tiles = [
            [_tile(name, *line[name], highest) if name in line else None for name in columns] for line in lines.values()
        ]
        heads = ["\n".join(PRIMITIVES[name]) for name in columns]
        return tiled(tiles, list(lines), heads, [("likelihood of contact, %", "heat", 0.0, 100 * highest)], size=0.95)


def _tile(name: str, data: DataSet, what: str, share: np.ndarray, highest: float) -> np.ndarray:
    colours = heat_colours(share, highest)
    if what in VIEWS:
        return tile(data.surface, what, colours, _TILE)
    mesh = data.object_mesh(name)
    return render([Shape(mesh.vertices, mesh.faces, colours)], size=_TILE)
