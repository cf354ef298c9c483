"""A rater's answers as the page sends them: one JSON object, every field checked.

{"study": …, "session": …, "list": 0, "platform": {"PROLIFIC_PID": …, "STUDY_ID": …, "SESSION_ID": …},
 "answers": [{"videos": [<name>], "answer": 1 … n, "seconds": 5.2}, …]}

A trial of a paired study has two videos, left and right, of which the answer is 1 or 2.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

from grabnet.study.key import StudyKey

PLATFORM_IDS = ("PROLIFIC_PID", "STUDY_ID", "SESSION_ID")
PLATFORM_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
_SESSION = re.compile(r"[0-9a-f]{32}")
_FIELDS = {"study", "session", "list", "platform", "answers"}
_MOST_SECONDS = 86_400.0


class RecordError(ValueError):
    """What is wrong with a record or with one of its answers, in a few words that quote nothing of it."""


def decode(text: str | bytes) -> Any:
    """A value of JSON, strictly: numbers finite, no key twice.

    Raises:
        RecordError: it is none.
    """

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len({name for name, _ in pairs}) < len(pairs):
            raise RecordError("a key is given twice")
        return dict(pairs)

    def finite(_: str) -> float:
        raise RecordError("a number is not finite")

    try:
        return json.loads(text, object_pairs_hook=once, parse_constant=finite)
    except (ValueError, RecursionError) as error:
        raise error if isinstance(error, RecordError) else RecordError("it is no JSON") from None


def check_frame(record: Any, key: StudyKey) -> None:
    """Check all fields of a record but its answers.

    Raises:
        RecordError: a field that is missing, unknown, or of another study.
    """
    if not isinstance(record, dict) or record.keys() != _FIELDS:
        raise RecordError(f"it must have the fields {', '.join(sorted(_FIELDS))}, and no others")
    if record["study"] != key.study:
        raise RecordError("it is of another study")
    if not isinstance(record["session"], str) or not _SESSION.fullmatch(record["session"]):
        raise RecordError("session must be 32 hexadecimal digits")
    if not _is_int(record["list"]) or not 0 <= record["list"] < len(key.lists):
        raise RecordError(f"list must be a number below {len(key.lists)}")
    platform = record["platform"]
    if not isinstance(platform, dict) or not platform.keys() <= set(PLATFORM_IDS):
        raise RecordError(f"platform may have {', '.join(PLATFORM_IDS)}, and nothing else")
    if not all(isinstance(value, str) and PLATFORM_ID.fullmatch(value) for value in platform.values()):
        raise RecordError("ids of the platform must be 1 to 64 letters, digits, - and _")
    if not isinstance(record["answers"], list):
        raise RecordError("answers must be a list")


def check_answer(answer: Any, key: StudyKey, number: int) -> None:
    """Check one answer of a record of this list.

    Raises:
        RecordError: a field that is missing or unknown, a trial that is not of the list, or no possible answer.
    """
    if not isinstance(answer, dict) or answer.keys() != {"videos", "answer", "seconds"}:
        raise RecordError("an answer must have the fields videos, answer and seconds, and no others")
    videos = answer["videos"]
    if not isinstance(videos, list) or not all(isinstance(name, str) for name in videos):
        raise RecordError("videos must be a list of names")
    if any(name not in key.videos for name in videos):
        raise RecordError("an answer is to a video that this study does not have")
    if len(set(videos)) < len(videos) or frozenset(videos) not in key.trials[number]:
        raise RecordError("an answer is to a trial that is not in this list")
    if not _is_int(answer["answer"]) or not 1 <= answer["answer"] <= len(key.levels):
        raise RecordError(f"an answer must be a whole number, 1 to {len(key.levels)}")
    seconds = answer["seconds"]
    if not (_is_int(seconds) or isinstance(seconds, float)) or not (
        math.isfinite(seconds) and 0 <= seconds <= _MOST_SECONDS
    ):
        raise RecordError("seconds must be a number, 0 to 86400")


def check_record(record: Any, key: StudyKey) -> None:
    """Check a whole record: every field, and one answer to each trial of its list.

    Raises:
        RecordError: something is not as it must be.
    """
    check_frame(record, key)
    number = record["list"]
    if len(record["answers"]) != len(key.trials[number]):
        raise RecordError(f"list {number} has {len(key.trials[number])} trials; each needs one answer")
    seen = set()
    for answer in record["answers"]:
        check_answer(answer, key, number)
        seen.add(frozenset(answer["videos"]))
    if len(seen) < len(record["answers"]):
        raise RecordError("a trial is answered twice")


def _is_int(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)
