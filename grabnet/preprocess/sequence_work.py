"""From one recording to its shards of training frames: what a worker does."""

from __future__ import annotations

import os
import socket
import sys
import traceback
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

from grabnet.body.whole import BodyModel
from grabnet.contact.sequences import annotate
from grabnet.data.frames import write_shard
from grabnet.data.sequences import Sequence, load_below, read_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh
from grabnet.io.files import DISK_ERRORS, existing, sha256
from grabnet.preprocess.backends import Outcome
from grabnet.preprocess.filtering import FrameFilter, frames_left
from grabnet.preprocess.grasp_track import GraspTrack
from grabnet.preprocess.heights import gap_to_table
from grabnet.preprocess.recordings import Recordings
from grabnet.preprocess.statistics import contact_counts, finger_counts, overlap


@dataclass(frozen=True)
class SequenceWork:
    """Writes the shards of a recording when called with its name; sent to workers as it is.

    Args:
        recordings: where the recording and all that it names lie.
        filter: which frames to keep.
        contact: "stored" or "recompute".
        contact_distance: ε of `ContactAnnotator`, metres.
        store: the frames store's folder.
        threads: of torch and warp.
    """

    recordings: Recordings
    filter: FrameFilter
    contact: str
    contact_distance: float
    store: Path
    threads: int

    def __call__(self, name: str) -> Outcome:
        """Never raises for what is wrong with the one recording.

        Raises:
            UserError: the disk takes no more.
        """
        torch.set_num_threads(self.threads)
        failure = None
        try:
            self._write(name)
        except UserError as error:
            failure = str(error)
        except Exception as error:
            of_store = isinstance(error, OSError) and Path(error.filename or self.store).is_relative_to(self.store)
            if of_store and error.errno in DISK_ERRORS:
                raise UserError(f"{self.store} cannot be written to ({error.strerror}): make room there.") from None
            at = [frame for frame in traceback.extract_tb(error.__traceback__) if "grabnet" in frame.filename][-1]
            failure = f"{type(error).__name__}: {error} ({Path(at.filename).name}, line {at.lineno})"
        return Outcome(name, failure, f"{socket.gethostname()}:{os.getpid()}", peak_memory())

    def _write(self, name: str) -> None:
        files = _Files(self.recordings.folder)
        path = files.used(f"grab/{name}.npz")
        sequence = read_sequence(path, self.recordings.objects)
        thing_file = str(self.recordings.objects[sequence.obj_name].relative_to(files.root))
        thing, counts = files.mesh(thing_file), {}
        if (n := sequence.contact.object.shape[1]) != len(thing.vertices):
            raise UserError(f"{path} labels {n} vertices of an object that has {len(thing.vertices)} in {thing_file}.")
        if self.contact == "recompute":
            sequence, counts["overlap"] = self._annotated(sequence, thing, files.mesh(sequence.body.vtemp))
        counts["contact"] = contact_counts(sequence)
        gap = None
        if self.filter.height == "table":
            gap = gap_to_table(sequence.object, thing, sequence.table, files.mesh(sequence.table.mesh))
        centroid = files.mesh(thing_file, weld=True).centroid  # as training has it
        tracks = [GraspTrack.right(sequence)] + [GraspTrack.left_mirrored(sequence)] * self.filter.mirror_left
        for track in tracks:
            files.mesh(track.hand.vtemp)  # of use at the end only, but missing it is a fault of this recording
        for track in tracks:
            passed = self.filter.passed(track, gap)
            kept = np.logical_and.reduce(list(passed.values())).nonzero()[0]
            write_shard(
                self.store,
                track.name,
                track.subject,
                track.object_name,
                track.frames(kept, centroid),
                intent=track.intent,
                template=track.hand.vtemp,
                inputs=files.sha256,
                counts=({} if track.is_mirrored else counts)
                | {"waterfall": frames_left(passed), "fingers": finger_counts(track.labels[kept])},
            )

    def _annotated(self, sequence: Sequence, thing: Mesh, template: Mesh) -> tuple[Sequence, dict[str, Any]]:
        """The recording with labels of our own, and how far they overlap with those in its file."""
        body, every = _body(self.recordings.body(sequence.gender)), self.filter.every
        v_template, stored = torch.tensor(template.vertices), sequence.contact
        if not len(v_template) == len(body.v_template) == stored.body.shape[1]:
            raise UserError(
                f"The body has {len(body.v_template)} vertices, {sequence.body.vtemp} {len(v_template)}, "
                f"and {sequence.name} labels {stored.body.shape[1]}: they must be of one kind."
            )
        found = annotate(sequence, body, v_template, thing, self.contact_distance, every)
        sides = {"object": (found.object, stored.object), "body": (found.body, stored.body)}
        overlaps = {side: overlap(*(labels[::every] for labels in both)) for side, both in sides.items()}
        return replace(sequence, contact=found), overlaps


class _Files:
    """Reads files below a root, and remembers which, by hash."""

    def __init__(self, root: Path):
        self.root, self.sha256 = root, {}

    def used(self, relative: str) -> Path:
        """Its path."""
        path = existing(self.root / relative, "File")
        self.sha256[relative] = sha256(path)
        return path

    def mesh(self, relative: str, weld: bool = False) -> Mesh:
        """A mesh; the latest ones are kept, as long as their files stay what they were."""
        self.used(relative)
        return _mesh(self.root, relative, weld, self.sha256[relative])


@lru_cache(maxsize=32)
def _mesh(root: Path, relative: str, weld: bool, sha256: str) -> Mesh:
    return load_mesh(root / relative) if weld else load_below(root, relative)


@lru_cache(maxsize=4)
def _body(path: Path) -> BodyModel:
    return BodyModel(path)


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
