"""From one recording to its shards of training frames: what a worker does."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from grabnet.cli.ends import as_user_error, unexpected
from grabnet.data.sources.base import write_frames
from grabnet.errors import printable
from grabnet.preprocess.backends import Outcome
from grabnet.preprocess.filtering import FrameFilter, frames_left
from grabnet.preprocess.grasp_track import mirrored
from grabnet.preprocess.recordings import RecordingSource
from grabnet.preprocess.statistics import finger_counts

# Raise it when the same recording, models and settings would give other shards.
FORMAT = 1


@dataclass(frozen=True)
class SequenceWork:
    """Writes the shards of a recording when called with its name; sent to workers as it is.

    Args:
        recordings: the data set.
        filter: which frames to keep.
        store: the frames store's folder.
        threads: of torch and warp.
    """

    recordings: RecordingSource
    filter: FrameFilter
    store: Path
    threads: int

    def __call__(self, name: str) -> Outcome:
        """Never raises for what is wrong with the one recording.

        Raises:
            OSError: the store cannot be written to.
        """
        torch.set_num_threads(self.threads)
        return outcome_of(name, self.store, lambda: self._write(name))

    def _write(self, name: str) -> None:
        recording = self.recordings.read(name)
        counts = recording.counts()
        gap = recording.gap_to_table() if self.filter.height == "table" else None
        tracks = [recording.right]
        if self.filter.mirror_left:
            tracks.append(recording.left_mirrored())
        for track in tracks:
            passed = self.filter.passed(track, gap)
            kept = np.logical_and.reduce(list(passed.values())).nonzero()[0]
            write_frames(
                self.store,
                track.name,
                track.frames(kept),
                mirrored(recording.centroid) if track.is_mirrored else torch.as_tensor(recording.centroid).float(),
                template=track.hand.vtemp,
                inputs=recording.inputs,
                counts=({} if track.is_mirrored else counts)
                | {"waterfall": frames_left(passed), "fingers": finger_counts(track.labels[kept])},
            )


def outcome_of(name: str, folder: Path, work: Callable[[], None]) -> Outcome:
    """How work on a recording, which writes to a folder, ends: what is wrong with the recording becomes a sentence.

    Raises:
        OSError: the folder cannot be written to.
    """
    failure = None
    try:
        work()
    except Exception as error:
        if isinstance(error, OSError) and error.errno and Path(error.filename or "").is_relative_to(folder):
            raise
        failure = str(as_user_error(error) or printable(unexpected(error)))
    return Outcome(name, failure, f"{socket.gethostname()}:{os.getpid()}", peak_memory())


def peak_memory() -> int:
    """Bytes of memory that this process has held at most; 0 where the system does not say (Windows)."""
    try:  # what getrusage says includes the process that this one was forked from
        status = Path("/proc/self/status").read_text()
        return 1024 * int(status.partition("VmHWM:")[2].split()[0])
    except OSError:
        pass
    try:
        import resource
    except ImportError:
        return 0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
