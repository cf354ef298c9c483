"""What the paper says of its data set (ref. 8; paper 3.5, S.5, Table 1), and how far a data set agrees."""

from __future__ import annotations

from collections.abc import Mapping

from grabnet.analysis.statistic import Row

# Of the frames of "use", per cent whose mean penetration is at most so many mm (paper S.5).
PENETRATION = {3.5: 67.0, 4.0: 86.0, 4.5: 96.0, 5.8: 99.9}
# Statistic, what chooses the line of its table, column, value.
_PUBLISHED = [
    *(
        ("content", {"by": by, "name": name}, column, value)
        for by, name, sequences, frames in (
            ("all", "all", 1334, 1_622_459),
            ("intent", "use", 579, 605_796),
            ("intent", "pass", 414, 335_733),
            ("intent", "lift", 274, 603_381),
            ("intent", "offhand", 67, 77_549),
        )
        for column, value in (("sequences", sequences), ("frames", frames))
    ),
    ("content", {"by": "all", "name": "all"}, "contact frames", 952_514),
    *(
        ("shares", {"intent": "use"}, f"{what} [%]", value)
        for what, value in (
            ("right hand", 92), ("left hand", 39), ("both hands", 31), ("head", 8),
            ("thumb", 100), ("index", 96), ("middle", 92), ("ring", 79), ("pinky", 39), ("palm", 24),
        )
    ),
    *(
        ("penetration", {"intent": "use", "surface": "hands", "of a frame": "mean"}, column, value)
        for column, value in (
            ("mean [mm]", 3.25), ("deviation [mm]", 0.68),
            *((f"≤ {limit} mm [%]", share) for limit, share in PENETRATION.items()),
        )
    ),
]  # fmt: skip


def agreement(tables: Mapping[str, list[Row]]) -> list[Row]:
    """Published numbers beside those of the same name in the tables of statistics, and the difference."""
    lines = []
    for statistic, chosen, column, published in _PUBLISHED:
        found = [row[column] for row in tables[statistic] if chosen.items() <= row.items()]
        line: Row = {"statistic": statistic, "of": ", ".join(v for k, v in chosen.items() if k != "by"), "what": column}
        line |= {"published": published, "here": found[0] if found else None}
        lines.append(line | {"difference": found[0] - published if found else None})
    return lines
