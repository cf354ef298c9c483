"""How much was recorded (paper Table 1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.frames import Frames, Subset
from grabnet.analysis.plots import bars, legend, panels
from grabnet.analysis.statistic import Analysed, Row, Statistic
from grabnet.data.intents import INTENTS


class Content(Statistic):
    """Sequences and frames by intent, subject and object."""

    name = "content"
    title = "Sequences and frames"
    about = "Recorded sequences, their frames, and the contact frames among these (paper Table 1)."

    def add(self, frames: Frames) -> None:
        contact = frames.contact_frames(self.rules.min_lift, self.rules.min_body_vertices)
        self.count(frames.group, "counts", np.array([1, len(frames), contact.sum()]))

    def result(self, subset: Subset) -> list[Row]:
        rows, groups = [], self.groups(subset)
        if groups:
            rows.append(self._row("all", "all", subset))
        for by, field in (("intent", "intents"), ("subject", "subjects"), ("object", "objects")):
            for name in sorted({getattr(group, by) for group in groups} - {""}, key=_in_order):
                rows.append(self._row(by, name, Subset(**(vars(subset) | {field: [name]}))))
        return rows

    def _row(self, by: str, name: str, subset: Subset) -> Row:
        sequences, frames, contact = map(int, self.total("counts", subset))
        return {"by": by, "name": name, "sequences": sequences, "frames": frames, "contact frames": contact}

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        tables = {each.label: each.rows(cls) for each in analysed}
        figure, axes = panels(3, 1, 9, 2.4)
        for here, by in zip(axes[:, 0], ("intent", "subject", "object"), strict=True):
            frames = {
                label: {row["name"]: row["frames"] for row in rows if row["by"] == by} for label, rows in tables.items()
            }
            names = sorted({name for found in frames.values() for name in found}, key=_in_order)
            bars(
                here,
                names,
                {label: [found.get(name, 0) for name in names] for label, found in frames.items()},
                "frames",
            )
            here.set_title(f"by {by}", loc="left", fontsize=9)
        legend(figure, axes[0, 0])
        return figure


def _in_order(name: str) -> tuple[int, int, str]:
    """Intents as the paper lists them; all else by name, s2 before s10."""
    number = name.lstrip("s")
    return INTENTS.index(name) if name in INTENTS else 9, int(number) if number.isdecimal() else 0, name
