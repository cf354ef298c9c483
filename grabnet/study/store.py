"""Answers on disk: one JSON object a line, only ever appended to, and on the disk before they are confirmed."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import filelock

from grabnet.errors import UserError
from grabnet.io.files import sha256
from grabnet.io.state import parsed_json


class ConflictError(Exception):
    """The session has stored other answers before."""


class AnswerStore:
    """The file of a study's answers, opened by one process at a time.

    A line that a killed process left unfinished stays as it is: what follows begins on a line of its own.

    Args:
        path: made where it is not there, readable by its owner alone.

    Raises:
        UserError: another process has it open.
    """

    def __init__(self, path: Path):
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self._lock = filelock.FileLock(path.with_suffix(".lock"))
        try:
            self._lock.acquire(timeout=0)
        except filelock.Timeout:
            raise UserError(f"{path} is in use by another server; end that one first.") from None
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o600)
        self.lists: dict[int, int] = {}
        self._stored: dict[str, str] = {}
        for record in self._read(path):
            self._note(record)

    def __enter__(self) -> AnswerStore:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        os.close(self._file)
        self._lock.release()

    def __len__(self) -> int:
        return len(self._stored)

    def add(self, records: list[dict[str, Any]]) -> list[Exception | None]:
        """Append records, each of which was checked, and wait until the disk has them.

        Returns:
            for each, None where it is stored, now or by an earlier call; or why it is not: a `ConflictError` or an
            `OSError`.
        """
        new: list[dict[str, Any]] = []
        outcomes: list[Exception | None] = []
        for record in records:
            known = self._stored.get(record["session"])
            if known is None:
                self._note(record)
                new.append(record)
            outcomes.append(None if known in (None, _digest(record)) else ConflictError())
        if not new:
            return outcomes
        try:
            self._append(b"".join(_line(record) for record in new))
        except OSError as error:
            for record in new:
                del self._stored[record["session"]]
                self.lists[record["list"]] -= 1
            failed = {record["session"] for record in new}
            return [error if record["session"] in failed else o for record, o in zip(records, outcomes, strict=True)]
        return outcomes

    def _append(self, data: bytes) -> None:
        size = os.fstat(self._file).st_size
        if size and os.pread(self._file, 1, size - 1) != b"\n":
            data = b"\n" + data
        try:
            while data:
                data = data[os.write(self._file, data) :]
            os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, size)  # a full disk: what was there before stays whole
            raise

    def _note(self, record: dict[str, Any]) -> None:
        self._stored[record["session"]] = _digest(record)
        self.lists[record["list"]] = self.lists.get(record["list"], 0) + 1

    @staticmethod
    def _read(path: Path) -> Iterator[dict[str, Any]]:
        for line in path.read_bytes().splitlines():
            try:
                yield parsed_json(line, {"session": str, "list": int, "*": object})
            except ValueError:
                continue  # a line that was cut off; the analysis names it


def _line(record: dict[str, Any]) -> bytes:
    return json.dumps(record, separators=(",", ":"), sort_keys=True, ensure_ascii=True).encode() + b"\n"


def _digest(record: dict[str, Any]) -> str:
    return sha256(_line(record))
