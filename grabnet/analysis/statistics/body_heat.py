"""Where bodies are touched (paper 3.5, Fig. 5, S.1, S.9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.comparing import compared
from grabnet.analysis.data_set import Surface
from grabnet.analysis.frames import WHO, Frames, Subset
from grabnet.analysis.plots import difference_colours, heat_colours, tiled
from grabnet.analysis.statistic import Analysed, Heat, Row, Statistic
from grabnet.body.skeleton import HEAD_PARTS, LEFT_HAND_PARTS, PARTS, RIGHT_HAND_PARTS
from grabnet.visual.pictures import Shape, can_render, render

_SIZE = (260, 260)


class _View(NamedTuple):
    """A picture of the body at rest: the parts seen, whose frames count, direction to the viewer, what points up."""

    parts: Sequence[int]
    of: str
    direction: Sequence[float]
    up: Sequence[float]


# SMPL-X at rest stands with y up and looks along z; its arms lie along x, palms down.
_VIEWS = {
    "body": _View(tuple(range(1, len(PARTS) + 1)), "frames", (0, 0.15, 1), (0, 1, 0)),
    "right palm": _View(RIGHT_HAND_PARTS, "right hand", (0, -1, 0), (-1, 0, 0)),
    "right back": _View(RIGHT_HAND_PARTS, "right hand", (0, 1, 0), (-1, 0, 0)),
    "left palm": _View(LEFT_HAND_PARTS, "left hand", (0, -1, 0), (1, 0, 0)),
    "left back": _View(LEFT_HAND_PARTS, "left hand", (0, 1, 0), (1, 0, 0)),
    "head": _View(HEAD_PARTS, "head", (0.5, 0.1, 1), (0, 1, 0)),
}


class BodyHeat(Statistic):
    """How often each vertex of the body touches an object."""

    name = "body_heat"
    title = "Contact on the body"
    about = (
        "Likelihood that a vertex of the body is in contact: on the body, over all contact frames; on hands and head, "
        "over those in which they take part (paper Fig. 5, S.9). Of bodies that differ, right hands are subtracted."
    )

    def add(self, frames: Frames) -> None:
        contact = frames.contact_frames(self.rules.min_lift, self.rules.min_body_vertices)
        who = [(frames.touching(parts) & contact).sum() for parts in WHO.values()]
        self.count(frames.group, "frames", np.array([contact.sum(), *who]))
        self.count(frames.group, "vertices", np.count_nonzero(frames.body[contact], axis=0).astype(np.uint32))

    def share(self, subset: Subset, of: str = "frames") -> np.ndarray | None:
        """(V,) likelihood among the contact frames of a subset, or those with a part; None without any."""
        frames = np.broadcast_to(self.total("frames", subset), 1 + len(WHO))
        n = dict(zip(("frames", *WHO), frames, strict=True))[of]
        return self.total("vertices", subset) / n if n else None

    def result(self, subset: Subset) -> list[Row]:
        rows = []
        for intent, chosen in self.by_intent(subset):
            counts = self.total("frames", chosen)
            share = self.share(chosen)
            row: Row = {"intent": intent, "contact frames": int(counts[0])}
            row["highest likelihood [%]"] = np.nan if share is None else 100 * float(share.max())
            row["vertices ever in contact"] = 0 if share is None else int((share > 0).sum())
            rows.append(row | {"vertices": len(self.total("vertices", chosen))})
        return rows

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        if can_render():
            return None
        seen = _seen(analysed, cls.name)
        shown = [share[_on(one.surface, _VIEWS[name].parts)] for one in seen for name, share in one.shares.items()]
        highest = max((float(share.max()) for share in shown if len(share)), default=0.0)
        if not highest:
            return None
        tiles = [
            [_tile(one.surface, v, heat_colours(one.shares[name], highest)) if name in one.shares else None
             for name, v in _VIEWS.items()]
            for one in seen
        ]  # fmt: skip
        lines, scales = [one.title for one in seen], [("likelihood of contact, %", "heat", 0.0, 100 * highest)]
        changes = {
            f"{a.title}\n− {b.title}": (a.surface, _changes(a, b))
            for a, b in compared(seen, lambda one: (one.label, one.intent))
        }
        most = max((float(np.abs(c).max()) for _, views in changes.values() for c in views.values()), default=0.0)
        if most:
            for title, (surface, change) in changes.items():
                lines.append(title)
                tiles.append([
                    _tile(surface, v, difference_colours(change[name], most)) if name in change else None
                    for name, v in _VIEWS.items()
                ])  # fmt: skip
            scales.append(("difference, percentage points", "difference", -100 * most, 100 * most))
        return tiled(tiles, lines, list(_VIEWS), scales)

    @classmethod
    def heats(cls, analysed: Sequence[Analysed]) -> dict[str, Heat]:
        shown = {"body": "body", "right hand": "right palm", "left hand": "left palm", "head": "head"}
        return {
            f"{what}, {one.title}".replace("\n", ", "): Heat(*_cut(one.surface, _VIEWS[view], one.shares[view]), "y")
            for one in _seen(analysed, cls.name)
            for what, view in shown.items()
            if view in one.shares
        }


class _Seen(NamedTuple):
    """Likelihoods of a data set's intent, by view, on its body."""

    label: str
    intent: str
    surface: Surface
    shares: dict[str, np.ndarray]

    @property
    def title(self) -> str:
        return f"{self.label}\n{self.intent}"


def _seen(analysed: Sequence[Analysed], statistic: str) -> list[_Seen]:
    found = []
    for each in analysed:
        heat = each.statistics[statistic]
        for intent, chosen in heat.by_intent(each.subset):
            surface = each.data.surface
            there = {
                name: heat.share(chosen, view.of) for name, view in _VIEWS.items() if _on(surface, view.parts).any()
            }
            found.append(_Seen(each.label, intent, surface, {n: s for n, s in there.items() if s is not None}))
    return found


def _changes(a: _Seen, b: _Seen) -> dict[str, np.ndarray]:
    """Differences of likelihoods on the body of `a`, by view; of bodies that differ, on the right hand alone."""
    found = {}
    for name in a.shares.keys() & b.shares.keys():
        one, other = a.shares[name], b.shares[name]
        if len(one) == len(other):
            found[name] = one - other
        elif _VIEWS[name].of == "right hand":
            found[name] = np.zeros(len(one))
            found[name][a.surface.right_hand] = one[a.surface.right_hand] - other[b.surface.right_hand]
    return found


def _on(surface: Surface, parts: Sequence[int]) -> np.ndarray:
    """(V,) bool: vertices of these parts."""
    return np.isin(surface.parts, parts)


def _cut(surface: Surface, view: _View, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices and faces of the parts that a view shows, and the values (V, …) of these vertices."""
    faces = surface.faces[_on(surface, view.parts)[surface.faces].all(1)]
    used, faces = np.unique(faces, return_inverse=True)
    return surface.vertices[used], faces.reshape(-1, 3), values[used]


def _tile(surface: Surface, view: _View, colours: np.ndarray) -> np.ndarray:
    return render([Shape(*_cut(surface, view, colours))], view.direction, view.up, _SIZE)
