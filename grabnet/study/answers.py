"""Answers of a study, from whatever files: each answer that is not clear is named and left out, none is guessed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from grabnet.errors import UserError
from grabnet.io.files import existing
from grabnet.study.key import CATCH, Shown, StudyKey
from grabnet.study.records import RecordError, check_answer, check_frame, decode
from grabnet.study.tables import BatchColumns, read_table

Trial = tuple[str, ...]


@dataclass(frozen=True)
class Answer:
    """One answer.

    rater: who gave it: the platform's id, or the session.
    videos: of the trial, as shown: one, or left and right.
    answer: 1 … n.
    seconds: that it took; None where that is not known.
    platform: ids of the recruiting platform.
    where: file and line, for messages.
    """

    rater: str
    videos: Trial
    answer: int
    seconds: float | None = None
    platform: Mapping[str, str] = field(default_factory=dict)
    where: str = ""


@dataclass
class Answers:
    """Answers that count, and what was left out.

    rows: of all raters.
    videos: what each shows.
    problems: a sentence for all that was left out.
    """

    rows: list[Answer]
    videos: dict[str, Shown]
    problems: list[str]

    @property
    def raters(self) -> list[str]:
        """In the order of their first answers."""
        return list(dict.fromkeys(row.rater for row in self.rows))

    @property
    def conditions(self) -> list[str]:
        """Without catch trials, in order of first use."""
        return list(dict.fromkeys(s.condition for s in self.videos.values() if s.condition != CATCH))

    def is_catch(self, row: Answer) -> bool:
        """Whether a trial has a grasp made to be implausible."""
        return any(self.videos[name].condition == CATCH for name in row.videos)

    def of(self, raters: Sequence[str]) -> Answers:
        """The answers of some raters."""
        kept = set(raters)
        return replace(self, rows=[row for row in self.rows if row.rater in kept])


def read_answers(
    files: Sequence[Path], key: StudyKey | None, videos: Mapping[str, Shown], levels: Sequence[str], batch: BatchColumns
) -> Answers:
    """Read answers: `.jsonl` and `.json` of this project's page, `.csv` plain or of a Mechanical Turk batch.

    Args:
        files: of these, or folders that hold some.
        key: of the study that the records belong to; None where there are only tables.
        videos: what the videos show; tables may name further ones by object, condition and grasp.
        levels: words of the answers, worst to best.
        batch: columns of batch files.

    Raises:
        UserError: a file that is not there, of another kind, or no text.
    """
    found = Answers([], dict(videos), [])
    for path in _expanded(files):
        if path.suffix.lower() == ".csv":
            rows = read_table(path, found.videos, levels, batch, found.problems)
            found.rows += [Answer(**row) for row in rows]
        elif key is None:
            raise UserError(f"{path} holds records of a page: name its study, export=<folder>.")
        else:
            found.rows += _records(path, key, found.problems)
    found.rows = _once(found.rows, found.problems)
    return found


def _expanded(files: Sequence[Path]) -> list[Path]:
    paths: list[Path] = []
    for path in files:
        existing(path, "Answers")
        inside = (
            sorted(p for p in path.iterdir() if p.suffix.lower() in (".jsonl", ".json", ".csv"))
            if path.is_dir()
            else [path]
        )
        if not inside:
            raise UserError(f"{path} holds no .jsonl, .json or .csv file.")
        paths += inside
    for path in paths:
        if path.suffix.lower() not in (".jsonl", ".json", ".csv"):
            raise UserError(f"{path} is of no kind that is read: .jsonl, .json or .csv.")
    return paths


def _records(path: Path, key: StudyKey, problems: list[str]) -> list[Answer]:
    """Answers of the records of a file, one a line."""
    rows: list[Answer] = []
    sessions: dict[str, str] = {}
    raters: set[str] = set()
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        where = f"{path.name}, line {number}"
        if not line.strip():
            continue
        try:
            record = decode(line)
            check_frame(record, key)
        except RecordError as wrong:
            problems.append(f"{where}: {wrong}; the record is left out")
            continue
        session, content = record["session"], line.decode(errors="replace")
        if session in sessions:
            same = "the same" if sessions[session] == content else "other"
            problems.append(f"{where}: its session has given {same} answers before; these are left out")
            continue
        sessions[session] = content
        rater = record["platform"].get("PROLIFIC_PID", session)
        if rater in raters:
            problems.append(f"{where}: rater {rater} has taken part before; the later answers are left out")
            continue
        raters.add(rater)
        rows += _checked(record, rater, key, where, problems)
    return rows


def _checked(record: dict, rater: str, key: StudyKey, where: str, problems: list[str]) -> list[Answer]:
    rows, number = [], record["list"]
    for position, answer in enumerate(record["answers"], 1):
        try:
            check_answer(answer, key, number)
        except RecordError as wrong:
            problems.append(f"{where}, answer {position}: {wrong}; it is left out")
            continue
        videos = tuple(answer["videos"])
        rows.append(Answer(rater, videos, answer["answer"], answer["seconds"], record["platform"], where))
    missing = len(key.trials[number] - {frozenset(row.videos) for row in rows})
    if missing:
        problems.append(f"{where}: {missing} of {len(key.trials[number])} trials have no answer that counts")
    return rows


def _once(rows: Sequence[Answer], problems: list[str]) -> list[Answer]:
    """Each rater's answer to each trial once; where several differ, none of them."""
    by_trial: dict[tuple[str, frozenset[str]], list[Answer]] = {}
    for row in rows:
        by_trial.setdefault((row.rater, frozenset(row.videos)), []).append(row)
    kept = []
    for (rater, _), given in by_trial.items():
        # Of a pair, what was chosen counts, on whichever side it was.
        said = {(row.videos[row.answer - 1] if len(row.videos) > 1 else row.answer) for row in given}
        if len(given) > 1:
            places = " and ".join(dict.fromkeys(row.where for row in given))
            fate = "the first counts" if len(said) == 1 else "as they differ, all are left out"
            problems.append(f"{places}: rater {rater} answers {'/'.join(given[0].videos)} {len(given)} times; {fate}")
        if len(said) == 1:
            kept.append(given[0])
    return kept
