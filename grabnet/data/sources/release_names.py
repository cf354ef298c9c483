"""Names of the published GrabNet frames (ref. 2): whose hand, on what object, which frame of which recording."""

from __future__ import annotations

import re
from pathlib import Path
from sys import intern
from typing import NamedTuple

import numpy as np

from grabnet.errors import UserError
from grabnet.io.npz import read_npz

# The last three parts of a name. What stands before them is a path on the machine that wrote the data.
_SUBJECT = re.compile(r"[A-Za-z0-9][\w-]{0,63}", re.ASCII)
_TAKE = re.compile(r"(?=.{5,128}$)[A-Za-z0-9]+_\w+_\w+", re.ASCII)
_FILE = re.compile(r"[0-9]{1,9}\.npz")


class FrameName(NamedTuple):
    """One frame: `s1/mug_pass_1/00123.npz`."""

    subject: str
    take: str
    file: str

    @property
    def sequence(self) -> str:
        return f"{self.subject}/{self.take}"

    @property
    def object(self) -> str:
        return self.take.split("_")[0]

    @property
    def action(self) -> str:
        return self.take.partition("_")[2].rpartition("_")[0]

    @property
    def frame(self) -> int:
        return int(self.file.removesuffix(".npz"))


def read_frame_names(path: Path) -> list[FrameName]:
    """Names in a `frame_names.npz`, one for each row of the split's arrays.

    Raises:
        UserError: not one list of text, an empty one, or a name of another form.
    """
    arrays = [np.asarray(array) for array in read_npz(path).values()]
    if len(arrays) != 1 or arrays[0].ndim != 1 or not len(arrays[0]):
        raise UserError(f"{path} holds {len(arrays)} arrays, expected one list of frame names: download it again.")
    return [_parsed(path, str(text)) for text in arrays[0]]


def _parsed(path: Path, text: str) -> FrameName:
    subject, take, file = ("", "", *text.rsplit("/", 3))[-3:]
    if not (_SUBJECT.fullmatch(subject) and _TAKE.fullmatch(take) and _FILE.fullmatch(file)):
        shown = text if len(text) <= 80 else f"{text[:40]}…{text[-40:]}"
        raise UserError(
            f"{path}: {shown!r} is no frame name like …/s1/mug_pass_1/00123.npz; it is not used as a path: download "
            f"the file again."
        )
    return FrameName(intern(subject), intern(take), file)
