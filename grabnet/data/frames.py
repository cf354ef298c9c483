"""The frames store: what a training frame is once all that can be recomputed is left out (≈ 0.25 kB a frame).

On disk:
    <root>/store.json                          what it is made of: names, counts, hashes, provenance
    <root>/subjects.safetensors                v_template (S, V, 3) of each subject's right hand
    <root>/shards/<subject>/<sequence>.safetensors   one per sequence: the unit of parallel work and of resuming
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from grabnet.body.hand import HandParameters
from grabnet.errors import UserError
from grabnet.files import existing, replacing, write_json
from grabnet.geometry.rotations import axis_angle_to_matrix

FORMAT = 1

# Per-frame values of a shard and their widths; all float32 but the frame number.
_VALUES = {"global_orient": 3, "hand_pose": 45, "transl": 3, "object_orient": 3}


@dataclass(frozen=True)
class Frames:
    """Right hands on objects, in the object-centred world frame (origin at the object's centroid, z up).

    Attributes:
        global_orient (N, 3), hand_pose (N, 45): axis-angle, radians. transl: (N, 3) metres.
        object_orient: (N, 3) axis-angle of the rotation that takes the object's frame to the world's.
        frame: (N,) int64 frame number in the sequence.
        subject, object, sequence: (N,) int64, into the store's names.
    """

    global_orient: Tensor
    hand_pose: Tensor
    transl: Tensor
    object_orient: Tensor
    frame: Tensor
    subject: Tensor
    object: Tensor
    sequence: Tensor

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, index: Tensor) -> Frames:
        """The frames at `index` (indices or a mask)."""
        return Frames(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def to(self, device: torch.device | str) -> Frames:
        """The same frames on `device`."""
        return Frames(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})

    def hand(self) -> HandParameters:
        """The frames' hands as rotation matrices."""
        return HandParameters(
            axis_angle_to_matrix(self.global_orient),
            axis_angle_to_matrix(self.hand_pose.unflatten(1, (15, 3))),
            self.transl,
        )


@dataclass(frozen=True)
class FramesStore:
    """All frames of a store in memory.

    Attributes:
        subjects, objects, sequences: names.
        v_template: (S, V, 3) rest right hand of each subject, metres.
        frames: every frame, ordered by sequence name and then as stored.
        card: the content of `store.json`.
    """

    subjects: list[str]
    objects: list[str]
    sequences: list[str]
    v_template: Tensor
    frames: Frames
    card: dict[str, Any]

    @classmethod
    def load(cls, root: str | Path) -> FramesStore:
        """Read a finished store.

        Raises:
            UserError: no store there, unfinished, of another format, or a damaged shard.
        """
        root = Path(root)
        card = json.loads(existing(root / "store.json", "Frames store").read_text())
        if card.get("format") != FORMAT:
            raise UserError(f"{root} is a frames store of format {card.get('format')}; this code reads {FORMAT}.")
        v_template = load_file(root / "subjects.safetensors")["v_template"]
        subjects, objects, sequences = card["subjects"], card["objects"], card["sequences"]
        shards = [_read_shard(root / "shards" / f"{sequence}.safetensors") for sequence in sequences]
        columns = {name: torch.cat([values[name] for _, values in shards]) for name in (*_VALUES, "frame")}
        lengths = torch.tensor([len(values["frame"]) for _, values in shards])

        def per_frame(values: list[int]) -> Tensor:
            return torch.tensor(values).repeat_interleave(lengths)

        frames = Frames(
            **columns,
            subject=per_frame([subjects.index(header["subject"]) for header, _ in shards]),
            object=per_frame([objects.index(header["object"]) for header, _ in shards]),
            sequence=per_frame(list(range(len(shards)))),
        )
        return cls(subjects, objects, sequences, v_template, frames, card)


def write_shard(
    root: str | Path, sequence: str, subject: str, object_name: str, values: dict[str, Tensor], **header: str
) -> None:
    """Write one sequence's frames atomically.

    Args:
        root: of the store.
        sequence: its name, `<subject>/<object>_<action>_<k>`.
        subject, object_name: whom and what it shows.
        values: `global_orient`, `hand_pose`, `transl`, `object_orient` and `frame`, as in `Frames`.
        header: further facts, for example `intent`.
    """
    tensors = {name: values[name].to(torch.float32).contiguous() for name in _VALUES}
    tensors["frame"] = values["frame"].to(torch.int32).contiguous()
    for name, width in _VALUES.items():
        if tensors[name].shape != (len(tensors["frame"]), width):
            raise ValueError(f"{sequence}: {name} has shape {tuple(tensors[name].shape)}, expected (N, {width})")
    with replacing(Path(root) / "shards" / f"{sequence}.safetensors") as temporary:
        save_file(tensors, temporary, {"subject": subject, "object": object_name, **header})


def finish_store(
    root: str | Path, v_template: dict[str, Tensor], objects: Iterable[str], provenance: dict[str, Any]
) -> None:
    """Make a store of the shards under `root`: subjects' hands, names, counts; written last, so that it means done.

    Args:
        root: of the store.
        v_template: (V, 3) rest right hand of each subject, by name.
        objects: names of all objects.
        provenance: JSON-able record of what the frames were made from and how.
    """
    root = Path(root)
    shards = root / "shards"
    sequences = sorted(str(p.relative_to(shards).with_suffix("")) for p in shards.rglob("[!.]*.safetensors"))
    with replacing(root / "subjects.safetensors") as temporary:
        save_file({"v_template": torch.stack(list(v_template.values()))}, temporary)
    card = {"format": FORMAT, "subjects": list(v_template), "objects": sorted(objects), "sequences": sequences}
    write_json(root / "store.json", card | {"provenance": provenance})


def _read_shard(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    try:
        with safe_open(path, "pt") as file:
            values = {name: file.get_tensor(name) for name in (*_VALUES, "frame")}
            return file.metadata(), values | {"frame": values["frame"].long()}
    except (SafetensorError, OSError) as error:
        raise UserError(
            f"Shard {path} is damaged or missing ({error}); delete it and run the preprocessing again."
        ) from None
