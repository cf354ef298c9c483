"""What takes part in contact (paper 3.5, Fig. S.9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.frames import FINGER_PARTS, WHO, Frames, Subset
from grabnet.analysis.plots import bars, legend, panels
from grabnet.analysis.statistic import Analysed, Row, Statistic

_WHO = ("right hand", "left hand", "both hands", "head")


class ContactShares(Statistic):
    """In how many contact frames hands and head touch, and in how many of the right hand's its fingers and palm do."""

    name = "shares"
    title = "Who touches"
    about = (
        "Share of the contact frames in which each takes part; of fingers and palm, share of those in which the right "
        "hand does (paper 3.5, Fig. S.9)."
    )
    by = ("intent",)

    def add(self, frames: Frames) -> None:
        contact = frames.contact_frames(self.rules.min_lift, self.rules.min_body_vertices)
        right, left, head = (frames.touching(parts) & contact for parts in WHO.values())
        fingers = [(frames.touching(parts) & right).sum() for parts in FINGER_PARTS.values()]
        who = [mask.sum() for mask in (right, left, right & left, head)]
        self.count(frames.group, "counts", np.array([contact.sum(), *who, *fingers]))

    def shares(self, subset: Subset) -> Row:
        """Number of contact frames, and shares in %; NaN of nothing."""
        counts = np.broadcast_to(self.total("counts", subset), 1 + len(_WHO) + len(FINGER_PARTS)).astype(float)
        frames, right = counts[0], counts[1]
        row: Row = {"contact frames": int(frames)}
        row |= {f"{who} [%]": _share(n, frames) for who, n in zip(_WHO, counts[1:5], strict=True)}
        return row | {f"{part} [%]": _share(n, right) for part, n in zip(FINGER_PARTS, counts[5:], strict=True)}

    def result(self, subset: Subset) -> list[Row]:
        return [{"intent": name} | self.shares(chosen) for name, chosen in self.by_intent(subset)]

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        tables = {each.label: {row["intent"]: row for row in each.rows(cls)} for each in analysed}
        intents = list(dict.fromkeys(intent for rows in tables.values() for intent in rows))
        figure, axes = panels(len(intents), 2, 5, 2.2)
        for line, intent in zip(axes, intents, strict=True):
            for here, names, of in zip(
                line, (_WHO, FINGER_PARTS), ("contact frames", "right-hand frames"), strict=True
            ):
                series = {
                    label: [rows[intent][f"{name} [%]"] if intent in rows else np.nan for name in names]
                    for label, rows in tables.items()
                }
                bars(here, list(names), series, f"% of {of}")
                here.set_ylim(0, 115)
                here.set_yticks(range(0, 101, 25))
                here.set_title(intent, loc="left", fontsize=9)
        legend(figure, axes[0, 0])
        return figure


def _share(part: float, whole: float) -> float:
    """Per cent; NaN of nothing."""
    return 100 * float(part) / float(whole) if whole else np.nan
