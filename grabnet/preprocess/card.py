"""What a data set of training frames is, counted from its shards: card, waterfall, agreement of labels."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from grabnet.body.anatomy import FINGERS
from grabnet.data.intents import action_of, intent_of
from grabnet.data.splits import MIRRORED_SUFFIX
from grabnet.io.files import replacing, write_json
from grabnet.preprocess.filtering import Waterfall
from grabnet.preprocess.statistics import agreement

_PARTS = (*FINGERS, "palm")


class Card:
    """Counts over all recordings.

    Args:
        headers: of every shard, by name.
        splits: train, val or test for every shard, by name.
        failed: recordings that could not be used.
        facts: what the card says besides: source, recipe, versions, hashes.
    """

    def __init__(
        self,
        headers: Mapping[str, Mapping[str, Any]],
        splits: Mapping[str, str],
        failed: Iterable[str],
        facts: Mapping[str, Any],
    ):
        self.headers, self.splits, self.waterfall = headers, splits, Waterfall()
        for name, header in headers.items():
            intent = intent_of(header["intent"])
            self.waterfall.add(splits[name], intent, header["object"], header["counts"]["waterfall"])
        self.content = {
            "sequences": self._sequences(sorted(failed)),
            "frames": self._frames(),
            "touching_in_frames": self._shares("fingers", lambda header: "all frames"),
            "touching_in_contact_frames": self._shares("contact", lambda header: intent_of(header["intent"])),
            **facts,
            "inputs_sha256": dict(sorted({f: s for h in headers.values() for f, s in h["inputs"].items()}.items())),
        }
        self.agreement = self._agreement()

    def write(self, folder: Path) -> None:
        """card.json, card.md, waterfall.csv and, where labels were compared, agreement.json."""
        write_json(folder / "card.json", self.content)
        with replacing(folder / "card.md") as temporary:
            temporary.write_text(self._markdown(), encoding="utf-8")
        with (
            replacing(folder / "waterfall.csv") as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            rows = self.waterfall.by("split", "intent", "object")
            writer = csv.writer(file)
            writer.writerow(["split", "intent", "object", *next(iter(rows.values()))])
            writer.writerows([*group, *left.values()] for group, left in rows.items())
        if self.agreement:
            write_json(folder / "agreement.json", self.agreement)

    def _sequences(self, failed: list[str]) -> dict[str, Any]:
        kept = {name: header["counts"]["fingers"]["frames"] for name, header in self.headers.items()}
        return {
            "read": sum(not name.endswith(MIRRORED_SUFFIX) for name in kept),
            "mirrored": sum(name.endswith(MIRRORED_SUFFIX) for name in kept),
            "without_frames": sum(n == 0 for n in kept.values()),
            "failed": failed,
        }

    def _frames(self) -> dict[str, Any]:
        """How many there are, in all and by split, intent (the paper's four), action, object and subject."""
        counts = {aspect: Counter() for aspect in ("split", "intent", "action", "object", "subject")}
        for name, header in self.headers.items():
            n = header["counts"]["fingers"]["frames"]
            counts["split"][self.splits[name]] += n
            counts["intent"][intent_of(header["intent"])] += n
            counts["action"][action_of(name)] += n
            for aspect in ("object", "subject"):
                counts[aspect][header[aspect]] += n
        by = {f"by_{aspect}": dict(sorted(counter.items())) for aspect, counter in counts.items()}
        return {"in_all": counts["split"].total(), **by}

    def _shares(self, kind: str, group_of: Callable[[Mapping[str, Any]], str]) -> dict[str, dict[str, Any]]:
        """Of frames, and of the paper's contact frames by intent: how many there are, and shares of what touches."""
        groups: dict[str, Counter[str]] = {}
        for header in self.headers.values():
            if kind in header["counts"]:
                groups.setdefault(group_of(header), Counter()).update(header["counts"][kind])
        return {name: _as_shares(counts) for name, counts in sorted(groups.items())}

    def _agreement(self) -> dict[str, Any]:
        overlaps = [h["counts"]["overlap"] for h in self.headers.values() if "overlap" in h["counts"]]
        return {side: agreement(o[side] for o in overlaps) for side in ("object", "body")} if overlaps else {}

    def _markdown(self) -> str:
        content, frames, sequences = self.content, self.content["frames"], self.content["sequences"]
        failed = f"; {len(sequences['failed'])} failed, see failures.json" if sequences["failed"] else ""
        mirrored = f" and {sequences['mirrored']} in a mirror" if sequences["mirrored"] else ""
        lines = [
            "# Training frames",
            "",
            f"{frames['in_all']:,} frames of {sequences['read']:,} recordings{mirrored}, of which "
            f"{sequences['without_frames']:,} gave none{failed}.",
            "",
            *_table("What the filter left", self._left()),
            *_table("Part of the right hand that touches, in the frames kept", content["touching_in_frames"]),
            *_table(
                "Who touches in contact frames (paper: object 5 mm off its height, 50 body vertices in contact)",
                content["touching_in_contact_frames"],
            ),
        ]
        for aspect in ("intent", "action", "subject", "object"):
            lines += [f"## By {aspect}", ""]
            lines += [", ".join(f"{name} {n:,}" for name, n in frames[f"by_{aspect}"].items()) + ".", ""]
        if self.agreement:
            lines += ["## Labels found and labels in the files, intersection over union by part", ""]
            for side, parts in self.agreement.items():
                lines += [f"On the {side}: " + ", ".join(f"{part}: {iou:.2f}" for part, iou in parts.items()) + ".", ""]
        lines += ["## Settings", ""]
        settings = content["recipe"] | content["recipe"]["filter"]
        lines += [f"- {key}: {value}" for key, value in settings.items() if not isinstance(value, dict)]
        lines.append("")
        return "\n".join(lines)

    def _left(self) -> dict[str, dict[str, Any]]:
        return {group[0]: left for group, left in self.waterfall.by("split").items()} | {
            "together": self.waterfall.by()[()]
        }


def _as_shares(counts: Mapping[str, int]) -> dict[str, Any]:
    """Counts as shares of `frames`; of fingers and palm of a recording, as shares of the frames of the right hand."""
    n, of_hand = counts["frames"], counts.get("right_hand", counts["frames"])
    shares: dict[str, Any] = {"frames": n}
    for name, count in counts.items():
        if name != "frames" and name not in _PARTS:
            shares[name] = round(count / n, 4) if n else None
    return shares | {part: round(counts[part] / of_hand, 4) if of_hand else None for part in _PARTS}


def _table(title: str, rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    heads = list(next(iter(rows.values()), {}))
    lines = [f"## {title}", "", "| |" + "|".join(heads) + "|", "|---" * (len(heads) + 1) + "|"]
    for name, values in rows.items():
        cells = [f"{v:,}" if isinstance(v, int) else "–" if v is None else f"{100 * v:.0f} %" for v in values.values()]
        lines.append(f"| {name} |" + "|".join(cells) + "|")
    return [*lines, ""]
