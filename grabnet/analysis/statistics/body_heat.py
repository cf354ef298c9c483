"""Where bodies are touched (paper 3.5, Fig. 5, S.1, S.9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.comparing import compared, is_alike, minus
from grabnet.analysis.data_set import Surface
from grabnet.analysis.frames import ALL, WHO, Frames, Subset
from grabnet.analysis.plots import difference_colours, heat_colours, tiled
from grabnet.analysis.statistic import Analysed, Heats, Row, Statistic
from grabnet.analysis.views import VIEWS, cut, on_view, shows, tile
from grabnet.visual.pictures import can_render

# What to turn in 3-D, and the view that says which parts and frames it is of.
_MESHES = {"body": "body front", "right hand": "right palm", "left hand": "left palm", "head": "head"}


class BodyHeat(Statistic):
    """How often each vertex of the body touches an object."""

    name = "body_heat"
    title = "Contact on the body"
    about = (
        "Likelihood that a vertex of the body is in contact: on the body, over all contact frames; on hands and head, "
        "over those in which they take part (paper Fig. 5, S.9). Of bodies that differ, right hands are subtracted."
    )
    by = ("intent",)

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
        shown = [share[on_view(one.surface, name)] for one in seen for name, share in one.shares.items()]
        highest = max((float(share.max()) for share in shown if len(share)), default=0.0)
        if not highest:
            return None
        tiles = [
            [tile(one.surface, name, heat_colours(one.shares[name], highest)) if name in one.shares else None
             for name in VIEWS]
            for one in seen
        ]  # fmt: skip
        lines, scales = [one.title for one in seen], [("likelihood of contact, %", "heat", 0.0, 100 * highest)]
        changes = {
            minus((a.label, a.intent), (b.label, b.intent)).replace(", ", "\n").replace(" − ", "\n− "): (
                a.surface, _changes(a, b)
            )
            for a, b in compared(seen, lambda one: (one.label, one.intent))
        }  # fmt: skip
        most = max(
            (
                float(np.abs(change[on_view(surface, name)]).max())
                for surface, views in changes.values()
                for name, change in views.items()
            ),
            default=0.0,
        )
        if most:
            for title, (surface, change) in changes.items():
                lines.append(title)
                tiles.append([
                    tile(surface, name, difference_colours(change[name], most)) if name in change else None
                    for name in VIEWS
                ])  # fmt: skip
            scales.append(("difference, percentage points", "difference", -100 * most, 100 * most))
        return tiled(tiles, lines, list(VIEWS), scales)

    @classmethod
    def heats(cls, analysed: Sequence[Analysed]) -> dict[str, Heats]:
        seen, found = _seen(analysed, cls.name), {}
        pairs = compared(seen, lambda one: (one.label, one.intent))
        for what, view in _MESHES.items():
            for one in seen:
                if view not in one.shares:
                    continue
                name = what if is_alike(one.surface, seen[0].surface) else f"{what} of {one.label}"
                vertices, faces, share = cut(one.surface, view, one.shares[view])
                heats = found.setdefault(name, Heats(vertices, faces, "y", {}, {}))
                heats.shares[f"{one.label}, {one.intent}"] = share
                for other in (b for a, b in pairs if a is one):
                    if (change := _changes(one, other).get(view)) is not None:
                        title = minus((one.label, one.intent), (other.label, other.intent))
                        heats.changes[title] = cut(one.surface, view, change)[2]
        return found


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
        for intent, chosen in heat.by_intent(ALL):
            surface = each.data.surface
            there = {name: heat.share(chosen, view.of) for name, view in VIEWS.items() if shows(surface, name)}
            found.append(_Seen(each.label, intent, surface, {n: s for n, s in there.items() if s is not None}))
    return found


def _changes(a: _Seen, b: _Seen) -> dict[str, np.ndarray]:
    """Differences of likelihoods on the body of `a`, by view; of bodies that differ, on the right hand alone."""
    found = {}
    for name in a.shares.keys() & b.shares.keys():
        one, other = a.shares[name], b.shares[name]
        if is_alike(a.surface, b.surface):
            found[name] = one - other
        elif VIEWS[name].of == "right hand":
            found[name] = np.zeros(len(one))
            found[name][a.surface.right_hand] = one[a.surface.right_hand] - other[b.surface.right_hand]
    return found
