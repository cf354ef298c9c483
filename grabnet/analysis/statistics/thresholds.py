"""How much the heuristics' thresholds matter (paper S.11, Fig. S.11)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from grabnet.analysis.frames import FINGER_PARTS, WHO, Frames, Subset
from grabnet.analysis.plots import COLOURS, legend, panels
from grabnet.analysis.statistic import Analysed, Row, Statistic

_COLOURS = (*COLOURS, "#8a5a9e", "#3b8f9c", "#7a6a53", "#28323c", "#98a2ad")


class Thresholds(Statistic):
    """Contact shares for each lift H of the object and each number C of object vertices that make a finger touch."""

    name = "thresholds"
    title = "Sensitivity to thresholds"
    about = (
        "Shares of contact when the object must be lifted by H, and when a part counts as touching from C object "
        "vertices on (paper S.11, Fig. S.11). Counted from the stored labels; nothing is annotated again."
    )

    by = ("intent",)

    def add(self, frames: Frames) -> None:
        parts = WHO | FINGER_PARTS
        counts = np.stack([frames.counts[:, list(labels)].sum(1) for labels in parts.values()], 1)  # (T, parts)
        touching = counts >= np.array(self.rules.finger_vertices)[:, None, None]  # (C, T, parts)
        touching[..., len(WHO) :] &= touching[..., :1]  # fingers: of the frames of the right hand
        found = []
        for lift in self.rules.lifts:
            contact = frames.contact_frames(lift, self.rules.min_body_vertices)
            n = np.full((len(touching), 1), contact.sum())
            found.append(np.concatenate([n, touching[:, contact].sum(1)], 1))
        self.count(frames.group, "counts", np.stack(found))  # (H, C, 1 + parts)

    def result(self, subset: Subset) -> list[Row]:
        rows = []
        for intent, chosen in self.by_intent(subset):
            table = self.total("counts", chosen).astype(float)
            for h, c in np.ndindex(table.shape[:2]):
                n, *touching = table[h, c]
                row: Row = {"intent": intent, "H [mm]": f"{1000 * self.rules.lifts[h]:g}"}
                row |= {"C": str(self.rules.finger_vertices[c]), "contact frames": int(n)}
                for k, (part, count) in enumerate(zip(WHO | FINGER_PARTS, touching, strict=True)):
                    whole = n if k < len(WHO) else touching[0]
                    row[f"{part} [%]"] = 100 * count / whole if whole else np.nan
                rows.append(row)
        return rows

    @classmethod
    def draw(cls, analysed: Sequence[Analysed]) -> Figure | None:
        tables = {each.label: [row for row in each.rows(cls) if row["intent"] == "all"] for each in analysed}
        parts, rules = [*WHO, *FINGER_PARTS], analysed[0].statistics[cls.name].rules
        figure, axes = panels(len(tables), 2, 5.2, 2.6)
        for line, (label, rows) in zip(axes, tables.items(), strict=True):
            lifts, counts = (list(dict.fromkeys(row[key] for row in rows)) for key in ("H [mm]", "C"))
            at_lift = [_nearest(lifts, 1000 * rules.min_lift)] if lifts else []
            fixed = {"H [mm]": ("C", counts[:1]), "C": ("H [mm]", at_lift)}
            for here, (along, (other, at)) in zip(line, fixed.items(), strict=True):
                for k, part in enumerate(parts):
                    chosen = [row for row in rows if row[other] in at]
                    places, values = [row[along] for row in chosen], [row[f"{part} [%]"] for row in chosen]
                    here.plot(places, values, "o-", markersize=3, color=_COLOURS[k], label=part)
                here.set_ylim(-3, 103)
                here.set_ylabel("% of contact frames;\nof fingers, of the right hand's")
                unit = "H, least lift of the object, mm" if along == "H [mm]" else "C, least object vertices per part"
                here.set_xlabel(f"{unit} ({other.removesuffix(' [mm]')} = {at[0] if at else '–'})")
                here.set_title(label, loc="left", fontsize=9)
        legend(figure, axes[0, 0])
        return figure


def _nearest(texts: list[str], value: float) -> str:
    return min(texts, key=lambda text: abs(float(text) - value))
