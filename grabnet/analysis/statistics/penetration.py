"""How deep hands are inside objects (paper S.5, Fig. S.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.frames import Frames, Subset
from grabnet.analysis.plots import COLOURS, legend, panels
from grabnet.analysis.published import PENETRATION
from grabnet.analysis.statistic import Analysed, Row, Statistic

# Bins of 0.1 mm; the last holds all that is deeper. Thresholds lie on their bounds.
_BIN, _BINS = 1e-4, 500
_KINDS = ("max", "mean", "median")


class Penetration(Statistic):
    """Per frame, the largest, mean and median depth over those vertices of the hands that are inside the object."""

    name = "penetration"
    title = "Penetration"
    about = (
        "Of each contact frame in which a vertex of a hand is inside the object: largest, mean and median depth over "
        "such vertices (paper S.5, Fig. S.2). Every n-th frame is posed (rules.posed_every)."
    )

    def add(self, frames: Frames) -> None:
        contact = frames.contact_frames(self.rules.min_lift, self.rules.min_body_vertices)
        chosen = contact.nonzero()[0][:: self.rules.posed_every]
        depths = [inside for depth in frames.depths(chosen) if len(inside := depth[depth > 0].astype(np.float64))]
        values = np.array([[d.max(), d.mean(), np.median(d)] for d in depths]).reshape(-1, len(_KINDS))
        bins = (np.ceil(values / _BIN - 1e-6).astype(int) - 1).clip(0, _BINS - 1)  # (low, high]
        self.count(frames.group, "posed", len(chosen))
        self.count(frames.group, "moments", np.stack([np.ones_like(values), values, values**2]).sum(1))
        self.count(frames.group, "bins", np.stack([np.bincount(column, minlength=_BINS) for column in bins.T]))

    def result(self, subset: Subset) -> list[Row]:
        rows = []
        for intent, chosen in self.by_intent(subset):
            bins, moments = self.total("bins", chosen), self.total("moments", chosen)
            for k, kind in enumerate(_KINDS):
                n, total, squares = moments[:, k]
                mean = total / n if n else np.nan
                row: Row = {"intent": intent, "of a frame": kind, "posed frames": int(self.total("posed", chosen))}
                row |= {"frames inside": int(n), "mean [mm]": 1000 * mean}
                row["deviation [mm]"] = 1000 * np.sqrt(max(squares / n - mean**2, 0)) if n else np.nan
                for limit in PENETRATION:
                    share = 100 * bins[k, : round(limit / 1000 / _BIN)].sum() / n if n else np.nan
                    row[f"≤ {limit} mm [%]"] = share
                rows.append(row)
        return rows

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        figure, axes = panels(len(analysed), 2, 5.2, 2.8)
        for line, each in zip(axes, analysed, strict=True):
            statistic, intents = each.statistics[cls.name], dict(each.statistics[cls.name].by_intent(each.subset))
            shown = "use" if "use" in intents else "all"  # the paper shows "use"
            bins = np.broadcast_to(statistic.total("bins", intents.get(shown, each.subset)), (len(_KINDS), _BINS))
            n = max(bins.sum(1).max(), 1)
            upper = 1000 * _BIN * np.arange(1, _BINS + 1)
            deepest = max(7.0, upper[min(_BINS - 1, int(np.searchsorted(np.cumsum(bins[0]), 0.99 * n)))])
            coarse = bins.reshape(len(_KINDS), -1, 5).sum(2)  # 0.5 mm
            for k, kind in enumerate(_KINDS):
                colour = (COLOURS[1], COLOURS[2], COLOURS[0])[k]
                line[0].plot(upper, 100 * np.cumsum(bins[k]) / n, color=colour, label=kind)
                line[1].step(upper[4::5] - 0.5, coarse[k], where="post", color=colour, label=kind)
            for limit, share in PENETRATION.items():
                line[0].plot(
                    limit, share, "kx", markersize=6, label="published, mean of “use”" if limit == 3.5 else None
                )
            for here, what in zip(line, ("% of frames at or below", "frames per 0.5 mm"), strict=True):
                here.set_xlim(0, deepest)
                here.set_xlabel("penetration, mm")
                here.set_ylabel(what)
                here.set_title(f"{each.label}, {shown}", loc="left", fontsize=9)
            line[0].set_ylim(0, 102)
        legend(figure, axes[0, 0])
        return figure
