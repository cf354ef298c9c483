"""Answers in tables: plain CSV, and the batch files that Mechanical Turk wrote until it closed.

Fields are parted by commas, semicolons or tabs.

Plain CSV has a line for each answer, with the columns `rater`, `rating`, and either `video` or `object`, `condition`
and `grasp`; catch trials have the condition `catch`. Further columns are not read.

A batch file has a line for each assignment, with `WorkerId`, and for each of its videos a column of the input and one
or several of the answer: the answer itself, or one column for each level that is `true` or `false`, or
`Answer.taskAnswers` with all of them as JSON.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from grabnet.errors import UserError
from grabnet.study.key import ALL, CATCH, EXAMPLE, Shown
from grabnet.study.records import PLATFORM_IDS, RecordError, decode

_MOST_COLUMNS = 2000


@dataclass(frozen=True)
class BatchColumns:
    """Columns of batch files, without the numbers that tell several videos of one assignment apart.

    video: of the input, with the video's name or address.
    answer: with the answer.
    """

    video: str
    answer: str


def read_table(
    path: Path, videos: dict[str, Shown], levels: Sequence[str], batch: BatchColumns, problems: list[str]
) -> Iterator[dict[str, Any]]:
    """Yield the arguments of each `Answer` in a table.

    Args:
        path: of the table.
        videos: what they show, by name without folders and suffix; those that the table names by object, condition and
            grasp are added.
        levels: words of the answers, worst to best.
        batch: columns of batch files.
        problems: gets a sentence for each line or answer that is left out.

    Raises:
        UserError: no CSV in UTF-8, or columns that are missing.
    """
    lines = _lines(path, problems)
    header, _ = next(lines, ([], 0))
    columns = set(header)
    if "WorkerId" in columns:
        pairs = _batch_columns(path, header, batch)
        for line, number in lines:
            yield from _assignment(dict(zip(header, line, strict=True)), pairs, videos, levels, batch,
                                   f"{path.name}, line {number}", problems)  # fmt: skip
        return
    named = {"object", "condition", "grasp"} <= columns
    if not {"rater", "rating"} <= columns or not ("video" in columns or named):
        raise UserError(
            f"{path} needs the columns rater, rating, and video or object, condition and grasp; of a batch, WorkerId."
        )
    for line, number in lines:
        row, where = dict(zip(header, line, strict=True)), f"{path.name}, line {number}"
        try:
            name = _named(row, videos) if "video" not in columns else _video(row["video"], videos)
            if not row["rater"].strip():
                raise RecordError("it names no rater")
            answer = _level(row["rating"], levels)
        except RecordError as wrong:
            problems.append(f"{where}: {wrong}; it is left out")
            continue
        platform = {name: row[name] for name in PLATFORM_IDS if row.get(name)}
        yield {"rater": row["rater"].strip(), "videos": (name,), "answer": answer, "platform": platform, "where": where}


def read_videos(path: Path) -> dict[str, Shown]:
    """What videos show, from a table with the columns video, object, condition and grasp.

    Raises:
        UserError: it cannot be read, or names a video twice.
    """
    problems: list[str] = []
    lines = _lines(path, problems)
    header, _ = next(lines, ([], 0))
    if not {"video", "object", "condition", "grasp"} <= set(header):
        raise UserError(f"{path} needs the columns video, object, condition and grasp.")
    videos: dict[str, Shown] = {}
    for line, number in lines:
        row = dict(zip(header, line, strict=True))
        try:
            name, shown = _stem(row["video"]), _shown(row)
        except RecordError as wrong:
            raise UserError(f"{path}, line {number}: {wrong}.") from None
        if name in videos:
            raise UserError(f"{path}, line {number}, names {name!r} a second time.")
        videos[name] = shown
    if problems:
        raise UserError(f"{problems[0]}.")
    return videos


def _lines(path: Path, problems: list[str]) -> Iterator[tuple[list[str], int]]:
    """The header and all lines with as many fields, each with its number in the file."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            first = next((line for line in file if line.strip()), "")
            file.seek(0)
            delimiter = max(",;\t", key=first.count)  # spreadsheets write ; where a comma is the decimal point
            reader = csv.reader(file, delimiter=delimiter, strict=True)
            header: list[str] | None = None
            for line in reader:
                if not line:
                    continue
                if header is None:
                    header = [name.strip() for name in line]
                    if len(set(header)) < len(header) or len(header) > _MOST_COLUMNS:
                        raise UserError(f"{path} has two columns of one name, or too many.")
                    yield header, reader.line_num
                elif len(line) != len(header):
                    problems.append(f"{path.name}, line {reader.line_num}: it has {len(line)} fields, the header "
                                    f"{len(header)}; it is left out")  # fmt: skip
                else:
                    yield line, reader.line_num
    except (UnicodeDecodeError, csv.Error, OSError) as error:
        raise UserError(f"{path} is no CSV in UTF-8 ({error}).") from None


def _batch_columns(path: Path, header: Sequence[str], batch: BatchColumns) -> dict[str, str]:
    """The input's column of each video, by the number that tells it apart; empty for a single one."""
    pattern = re.compile(re.escape(batch.video) + r"(?:_url)?_?(\d*)")
    pairs = {match[1]: name for name in header if (match := pattern.fullmatch(name))}
    if not pairs:
        raise UserError(f"{path} has no column {batch.video}: name the video's with batch.video.")
    return pairs


def _assignment(
    row: Mapping[str, str], pairs: Mapping[str, str], videos: Mapping[str, Shown], levels: Sequence[str],
    batch: BatchColumns, where: str, problems: list[str],
) -> Iterator[dict[str, Any]]:  # fmt: skip
    if row.get("AssignmentStatus", "").strip().lower() == "rejected":
        problems.append(f"{where}: the assignment was rejected; it is left out")
        return
    rater = row["WorkerId"].strip()
    for number, column in pairs.items():
        try:
            if not rater:
                raise RecordError("it names no worker")
            name = _video(row[column], videos)
            answer = _level(_batch_answer(row, number, len(levels), batch), levels)
        except RecordError as wrong:
            problems.append(f"{where}, {column}: {wrong}; it is left out")
            continue
        yield {"rater": rater, "videos": (name,), "answer": answer, "where": where}


def _batch_answer(row: Mapping[str, str], number: str, n: int, batch: BatchColumns) -> str:
    """The answer's text: of its column, of the one level that is true, or of the answers as JSON."""
    for spelt in dict.fromkeys((f"{batch.answer}{number}", f"{batch.answer}_{number}".rstrip("_"))):
        if spelt in row:
            return row[spelt]
        levels = {k: row[f"{spelt}.{k}"] for k in range(1, n + 1) if f"{spelt}.{k}" in row}
        if levels:
            return _chosen({str(k): value.strip().lower() == "true" for k, value in levels.items()})
        field = spelt.removeprefix("Answer.")
        if row.get("Answer.taskAnswers"):
            answers = decode(row["Answer.taskAnswers"])
            answers = answers[0] if isinstance(answers, list) and len(answers) == 1 else answers
            value = answers.get(field) if isinstance(answers, dict) else None
            if isinstance(value, dict):
                return _chosen({str(level): said is True for level, said in value.items()})
            if value is not None:
                return str(value)
    raise RecordError("it has no answer")


def _chosen(levels: Mapping[str, bool]) -> str:
    chosen = [level for level, said in levels.items() if said]
    if len(chosen) != 1:
        raise RecordError("it has no answer" if not chosen else "several levels are chosen")
    return chosen[0]


def _level(text: str, levels: Sequence[str]) -> int:
    """1 … n, of a number or of a level's words."""
    text = text.strip()
    if not text:
        raise RecordError("it has no answer")
    words = [level.casefold() for level in levels]
    if text.casefold() in words:
        return words.index(text.casefold()) + 1
    if not re.fullmatch(r"[0-9]{1,3}(\.0{1,6})?", text) or not 1 <= (level := int(float(text))) <= len(levels):
        raise RecordError(f"{_quoted(text)} is no answer from 1 to {len(levels)}")
    return level


def _video(text: str, videos: Mapping[str, Shown]) -> str:
    name = _stem(text)
    if name not in videos:
        raise RecordError(f"{_quoted(text)} is no video of this study")
    return name


def _stem(text: str) -> str:
    """A video's name, of a name with a suffix or an address."""
    return PurePosixPath(urlsplit(text.strip()).path if "//" in text else text.strip()).stem


def _named(row: Mapping[str, str], videos: dict[str, Shown]) -> str:
    shown = _shown(row)
    name = f"{shown.object}:{shown.condition}:{shown.grasp}"
    videos.setdefault(name, shown)
    return name


def _shown(row: Mapping[str, str]) -> Shown:
    values = [row[name].strip() for name in ("object", "condition", "grasp")]
    if not all(values) or not re.fullmatch(r"[0-9]{1,9}", values[2]):
        raise RecordError("it needs an object, a condition, and a grasp's number")
    if values[0] == ALL or values[1] == EXAMPLE:
        raise RecordError(f"no object can be called {ALL}, and no condition {EXAMPLE}")
    condition = CATCH if values[1].casefold() == CATCH else values[1]
    return Shown(values[0], condition, int(values[2]))


def _quoted(text: str) -> str:
    """A value of a file in a message: short, on one line, and nothing that a terminal obeys."""
    return ascii(text if len(text) <= 40 else f"{text[:40]}…")
