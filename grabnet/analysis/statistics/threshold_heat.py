"""Heatmaps for other thresholds of the heuristics (paper S.11, Fig. S.11)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.frames import ALL, Frames, Subset
from grabnet.analysis.plots import heat_colours, tiled
from grabnet.analysis.rules import Rules
from grabnet.analysis.statistic import Analysed, Row, Statistic
from grabnet.analysis.views import on_view, shows, tile
from grabnet.body.skeleton import MIRRORED_PART, N_PARTS, RIGHT_FINGER_PARTS
from grabnet.visual.pictures import can_render

_SHOWN = ("body front", "right palm", "left palm", "head")


def _together() -> np.ndarray:
    """(56, 56) which parts count together: those of a finger."""
    found = np.eye(N_PARTS + 1, dtype=int)
    for parts in RIGHT_FINGER_PARTS.values():
        for finger in (list(parts), MIRRORED_PART[list(parts)]):
            found[np.ix_(finger, finger)] = 1
    found[0] = 0
    return found


_TOGETHER = _together()


def setups(rules: Rules) -> list[tuple[float, int]]:
    """Pairs of H and C: that of the other figures first, then those in which one of the two differs."""
    base = min(rules.lifts, key=lambda lift: abs(lift - rules.min_lift)), rules.finger_vertices[0]
    pairs = [(lift, base[1]) for lift in rules.lifts] + [(base[0], least) for least in rules.finger_vertices]
    return list(dict.fromkeys([base, *pairs]))


class ThresholdHeat(Statistic):
    """How often each vertex of the body touches, for pairs of H and C."""

    name = "threshold_heat"
    title = "Heatmaps by threshold"
    about = (
        "Likelihood of contact over the frames in which the object is lifted by H, where a finger or another part of "
        "the body counts as touching from C object vertices on (paper S.11, Fig. S.11). Counted from the stored labels."
    )
    by = ("intent",)

    def add(self, frames: Frames) -> None:
        ever = frames.body.any(0).nonzero()[0]
        own, counts = frames.body[:, ever], frames.counts @ _TOGETHER
        pairs = setups(self.rules)
        vertices = np.zeros((len(pairs), frames.body.shape[1]), np.uint32)
        n = np.zeros(len(pairs), int)
        for k, (lift, least) in enumerate(pairs):
            contact = frames.contact_frames(lift, self.rules.min_body_vertices)
            touching = np.take_along_axis((counts >= least)[contact], own[contact].astype(int), 1)
            n[k], vertices[k, ever] = contact.sum(), (touching & (own[contact] > 0)).sum(0)
        self.count(frames.group, "frames", n)
        self.count(frames.group, "vertices", vertices)

    def shares(self, subset: Subset) -> list[np.ndarray | None]:
        """(V,) likelihood of each of `setups`; None where it has no frames."""
        frames = np.broadcast_to(self.total("frames", subset), len(setups(self.rules)))
        return [self.total("vertices", subset)[k] / n if n else None for k, n in enumerate(frames)]

    def result(self, subset: Subset) -> list[Row]:
        rows = []
        for intent, chosen in self.by_intent(subset):
            shares, frames = self.shares(chosen), self.total("frames", chosen)
            for (lift, least), share, n in zip(setups(self.rules), shares, frames, strict=True):
                row: Row = {"intent": intent, "H [mm]": f"{1000 * lift:g}", "C": str(least), "contact frames": int(n)}
                row["highest likelihood [%]"] = np.nan if share is None else 100 * float(share.max())
                change = None if share is None or shares[0] is None else 100 * np.abs(share - shares[0])
                row["largest change [points]"] = np.nan if change is None else float(change.max())
                # Over vertices that either touches; all others agree.
                some = None if change is None else change[(share > 0) | (shares[0] > 0)]
                row["mean change [points]"] = float(some.mean()) if some is not None and len(some) else np.nan
                rows.append(row)
        return rows

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        if can_render():
            return None
        rules = analysed[0].statistics[cls.name].rules
        found = {each.label: each.statistics[cls.name].shares(ALL) for each in analysed}
        highest = max((float(s.max()) for shares in found.values() for s in shares if s is not None), default=0.0)
        if not highest:
            return None
        tiles, lines = [], []
        for each in analysed:
            surface, shares = each.data.surface, found[each.label]
            for view in _SHOWN:
                if shows(surface, view) and any(
                    share is not None and share[on_view(surface, view)].any() for share in shares
                ):
                    tiles.append([None if s is None else tile(surface, view, heat_colours(s, highest)) for s in shares])
                    lines.append(f"{each.label}\n{view}")
        heads = [f"H = {1000 * lift:g} mm\nC = {least}" for lift, least in setups(rules)]
        return tiled(tiles, lines, heads, [("likelihood of contact, %", "heat", 0.0, 100 * highest)], size=1.3)
