"""How deep hands, head and body are inside objects (paper S.5, Fig. S.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from grabnet.analysis.frames import ALL, SURFACES, Frames, Subset
from grabnet.analysis.plots import COLOURS, legend, panels
from grabnet.analysis.published import PENETRATION
from grabnet.analysis.statistic import Analysed, Row, Statistic

# Bins of 0.1 mm; the last holds all that is deeper. Thresholds lie on their bounds.
_BIN, _BINS = 1e-4, 500
_KINDS = ("max", "mean", "median")


class Penetration(Statistic):
    """Per frame, the largest, mean and median depth over those vertices of a surface that are inside the object."""

    name = "penetration"
    title = "Penetration"
    about = (
        "Of each contact frame in which a vertex of the hands, the head or the rest of the body is inside the object: "
        "largest, mean and median depth over such vertices (paper S.5, Fig. S.2). Of the contact frames in which the "
        "surface touches, every n-th is posed (rules.posed_every), of generated grasps all."
    )
    by = ("intent",)

    def add(self, frames: Frames) -> None:
        contact = frames.contact_frames(self.rules.min_lift, self.rules.min_body_vertices)
        # Generated grasps have no lift and follow each other in no order: all are posed.
        step = 1 if np.isinf(frames.lift).all() else self.rules.posed_every
        for surface in frames.surfaces:
            chosen = (contact & frames.touching(SURFACES[surface])).nonzero()[0][::step]
            depths = [inside.astype(np.float64) for inside in frames.depths(surface, chosen) if len(inside)]
            values = np.array([[d.max(), d.mean(), np.median(d)] for d in depths]).reshape(-1, len(_KINDS))
            bins = (np.ceil(values / _BIN - 1e-6).astype(int) - 1).clip(0, _BINS - 1)  # (low, high]
            counts = np.stack([np.bincount(column, minlength=_BINS) for column in bins.T])
            self.count(frames.group, f"{surface} posed", len(chosen))
            self.count(frames.group, f"{surface} moments", np.stack([np.ones_like(values), values, values**2]).sum(1))
            self.count(frames.group, f"{surface} bins", counts)

    def bins(self, surface: str, subset: Subset) -> np.ndarray:
        """(3, 500) frames whose max, mean and median depth lie in each bin of 0.1 mm."""
        return np.broadcast_to(self.total(f"{surface} bins", subset), (len(_KINDS), _BINS))

    def surfaces(self, subset: Subset) -> list[str]:
        """Those that were posed, the hands always."""
        return [name for name in SURFACES if name == "hands" or self.total(f"{name} posed", subset)]

    def result(self, subset: Subset) -> list[Row]:
        return [
            self._row(intent, chosen, surface, k)
            for intent, chosen in self.by_intent(subset)
            for surface in self.surfaces(chosen)
            for k in range(len(_KINDS))
        ]

    def _row(self, intent: str, chosen: Subset, surface: str, k: int) -> Row:
        n, total, squares = self.total(f"{surface} moments", chosen)[:, k]
        mean, bins = total / n if n else np.nan, self.bins(surface, chosen)[k]
        row: Row = {"intent": intent, "surface": surface, "of a frame": _KINDS[k]}
        row |= {"posed frames": int(self.total(f"{surface} posed", chosen)), "frames inside": int(n)}
        row |= {"mean [mm]": 1000 * mean}
        row["deviation [mm]"] = 1000 * np.sqrt(max(squares / n - mean**2, 0)) if n else np.nan
        shares = {limit: bins[: round(limit / 1000 / _BIN)].sum() / n if n else np.nan for limit in PENETRATION}
        return row | {f"≤ {limit} mm [%]": 100 * share for limit, share in shares.items()}

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        lines = []
        for each in analysed:
            statistic = each.statistics[cls.name]
            intents = dict(statistic.by_intent(ALL))
            shown = "use" if "use" in intents else "all"  # the paper shows "use"
            chosen = intents.get(shown, ALL)
            inside = [name for name in statistic.surfaces(chosen) if statistic.bins(name, chosen).any()]
            for surface in inside or ["hands"]:
                lines.append((f"{each.label}, {shown}, {surface}", statistic.bins(surface, chosen)))
        figure, axes = panels(len(lines), 2, 5.2, 2.8)
        for line, (title, bins) in zip(axes, lines, strict=True):
            _draw(line, title, bins)
        legend(figure, axes[0, 0])
        return figure


def _draw(axes: Sequence[Axes], title: str, bins: np.ndarray) -> None:
    """Cumulative curve with the published thresholds beside, and histogram, of (3, 500) counted frames."""
    n = max(bins.sum(1).max(), 1)
    upper = 1000 * _BIN * np.arange(_BINS + 1)
    last = int(np.searchsorted(np.cumsum(bins[0]), 0.99 * n)) + 5 if bins.any() else 0
    deepest = max(7.0, upper[min(_BINS, last)])
    for k, kind in enumerate(_KINDS):
        colour = (COLOURS[1], COLOURS[2], COLOURS[0])[k]
        axes[0].plot(upper, 100 * np.cumsum([0, *bins[k]]) / n, color=colour, label=kind)
        axes[1].stairs(bins[k].reshape(-1, 5).sum(1), upper[::5], color=colour, fill=True, alpha=0.35)  # 0.5 mm
        axes[1].stairs(bins[k].reshape(-1, 5).sum(1), upper[::5], color=colour, label=kind)
    for limit, share in PENETRATION.items():
        axes[0].axvline(limit, color="#cfd6dc", linewidth=0.8, zorder=0)
        label = "published, mean of “use”" if limit == min(PENETRATION) else None
        axes[0].plot(limit, share, "kx", markersize=6, label=label)
    for here, what in zip(axes, ("% of frames at or below", "frames per 0.5 mm"), strict=True):
        here.set_xlim(0, deepest)
        here.set_ylim(0, 102 if here is axes[0] else None)
        here.set_xlabel("penetration, mm")
        here.set_ylabel(what)
        here.set_title(title, loc="left", fontsize=9)
