"""The frames store: what a training frame is once all that can be recomputed is left out (≈ 0.25 kB a frame).

On disk:
    <root>/recipe.json                         what it is made from and how; written first
    <root>/store.json                          what it is made of: names, counts, hashes, provenance; written last
    <root>/subjects.safetensors                v_template (S, V, 3) of each subject's right hand
    <root>/shards/<subject>/<sequence>.safetensors   one per sequence: the unit of parallel work and of resuming

The same frames give the same bytes, whenever and wherever they are written.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save
from torch import Tensor

from grabnet.body.hand import HandParameters
from grabnet.data.names import check_sequence_name
from grabnet.errors import UserError
from grabnet.geometry.rotations import axis_angle_to_matrix
from grabnet.io.files import existing, write_bytes, write_json
from grabnet.io.litter import clear_litter
from grabnet.io.recipes import claim
from grabnet.io.state import Kind, parsed_json, read_json
from grabnet.io.tensors import check_tensors, fact, header_facts, read_tensors

# Raise it when a store must be read otherwise.
FORMAT = 4

# Per-frame values of a shard and their widths; all float32 but the frame number.
_VALUES = {"global_orient": 3, "hand_pose": 45, "transl": 3, "object_orient": 3}
# Only in stores that hold another, noisy hand for each frame: its difference from the true one in global_orient,
# hand_pose and transl, as float16, which is wrong by a 2000th of the noise at most.
_NOISE = {"noise": 51}
_TYPES = {"frame": torch.int64, "noise": torch.float16}
# What cards and headers of shards must say.
_CARD: Kind = {"format": int, "subjects": [str], "objects": [str], "sequences": [str], "hand_sha256": str}
_CARD |= {"provenance": {str: object}}
_SHARD: Kind = {"subject": str, "object": str, "intent?": str}
_REMEDY = "delete it and run the preprocessing again"


@dataclass(frozen=True)
class Frames:
    """Right hands on objects, in the object-centred world frame (origin at the object's centroid, z up).

    Attributes:
        global_orient (N, 3), hand_pose (N, 45): axis-angle, radians. transl: (N, 3) metres.
        object_orient: (N, 3) axis-angle of the rotation that takes the object's frame to the world's.
        frame: (N,) int64 frame number in the sequence.
        subject, object, sequence: (N,) int64, into the store's names.
        noisy: (N, 51) global_orient, hand_pose and transl of a hand near the true one, where the store has such.
    """

    global_orient: Tensor
    hand_pose: Tensor
    transl: Tensor
    object_orient: Tensor
    frame: Tensor
    subject: Tensor
    object: Tensor
    sequence: Tensor
    noisy: Tensor | None = None

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, index: Tensor) -> Frames:
        """The frames at `index` (indices or a mask)."""
        return self._each(lambda values: values[index])

    def to(self, device: torch.device | str) -> Frames:
        """The same frames on `device`."""
        return self._each(lambda values: values.to(device))

    def hand(self) -> HandParameters:
        """The frames' hands as rotation matrices."""
        return _parameters(self.global_orient, self.hand_pose, self.transl)

    def noisy_hand(self) -> HandParameters | None:
        """The noisy hands, where there are any."""
        return None if self.noisy is None else _parameters(*self.noisy.split((3, 45, 3), 1))

    def _each(self, change: Callable[[Tensor], Tensor]) -> Frames:
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return Frames(**{name: v if v is None else change(v) for name, v in values.items()})


def _parameters(global_orient: Tensor, hand_pose: Tensor, transl: Tensor) -> HandParameters:
    fingers = axis_angle_to_matrix(hand_pose.unflatten(1, (15, 3)))
    return HandParameters(axis_angle_to_matrix(global_orient), fingers, transl)


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

    @property
    def shown_objects(self) -> list[str]:
        """Names of the objects with any frame."""
        return [self.objects[number] for number in self.frames.object.unique().tolist()]

    def part(self, index: Tensor) -> FramesStore:
        """The store with the frames at `index` only."""
        return replace(self, frames=self.frames.select(index))

    @classmethod
    def load(cls, root: str | Path) -> FramesStore:
        """Read a finished store.

        Raises:
            UserError: no store there, unfinished, empty, of another format, or damaged.
        """
        root = Path(root)
        path = existing(root / "store.json", "Frames store")
        card = read_json(path, {"format": object}, _REMEDY)
        if card["format"] != FORMAT:
            raise UserError(
                f"{root} is a frames store of format {card['format']}, and {FORMAT} is read here: delete it and "
                "make it again."
            )
        card = read_json(path, _CARD, _REMEDY)
        subjects, objects, sequences = card["subjects"], card["objects"], card["sequences"]
        if not sequences:
            raise UserError(f"The frames store {root} is empty: delete it and make it again.")
        for name in sequences:
            check_sequence_name(name, f"{path}: ")
        if len(set(sequences)) < len(sequences):
            raise UserError(f"{path} is damaged (it names a sequence twice): {_REMEDY}.")
        stored = read_tensors(root / "subjects.safetensors", "File", _REMEDY)
        check_tensors(stored, {"v_template": (len(subjects), "V", 3)}, _REMEDY)
        frames = read_frames(root, subjects, objects, sequences)
        return cls(subjects, objects, sequences, stored.values["v_template"], frames, card)


def read_frames(root: str | Path, subjects: list[str], objects: list[str], sequences: list[str]) -> Frames:
    """The frames of a store's shards, numbered by these names.

    Raises:
        UserError: a damaged shard.
    """
    shards = [_read_shard(shard_path(root, sequence)) for sequence in sequences]
    for sequence, (header, _) in zip(sequences, shards, strict=True):
        for what, known in (("subject", subjects), ("object", objects)):
            if header[what] not in known:
                raise UserError(
                    f"{shard_path(root, sequence)} shows the {what} {header[what]}, which the store has not: {_REMEDY}."
                )
    noisy = all("noise" in values for _, values in shards)
    columns = {name: torch.cat([values[name] for _, values in shards]) for name in (*_VALUES, "frame")}
    lengths = torch.tensor([len(values["frame"]) for _, values in shards])

    def per_frame(values: list[int]) -> Tensor:
        return torch.tensor(values).repeat_interleave(lengths)

    return Frames(
        **columns,
        subject=per_frame([subjects.index(header["subject"]) for header, _ in shards]),
        object=per_frame([objects.index(header["object"]) for header, _ in shards]),
        sequence=per_frame(list(range(len(shards)))),
        noisy=torch.cat([_true_hand(values) + values["noise"].float() for _, values in shards]) if noisy else None,
    )


def shard_path(root: str | Path, sequence: str) -> Path:
    """Where the shard of a sequence lies, or would."""
    return Path(root) / "shards" / f"{sequence}.safetensors"


def shard_names(root: str | Path) -> list[str]:
    """Sequences that have a shard, in order."""
    shards = Path(root) / "shards"
    return sorted(str(p.relative_to(shards).with_suffix("")) for p in shards.rglob("[!.]*.safetensors"))


def write_shard(
    root: str | Path, sequence: str, subject: str, object_name: str, values: dict[str, Tensor], **header: Any
) -> None:
    """Write one sequence's frames atomically.

    Args:
        root: of the store.
        sequence: its name, `<subject>/<object>_<action>_<k>`.
        subject, object_name: whom and what it shows.
        values: `global_orient`, `hand_pose`, `transl`, `object_orient` and `frame`, as in `Frames`; `noisy`, too, if
            every shard of the store has it.
        header: further facts that JSON can say, for example `intent`.
    """
    widths = dict(_VALUES)
    tensors = {name: values[name].to(torch.float32).contiguous() for name in widths}
    if "noisy" in values:
        widths |= _NOISE
        tensors["noise"] = _noise(values["noisy"], _true_hand(tensors)).to(torch.float16)
    tensors["frame"] = values["frame"].to(torch.int32).contiguous()
    for name, width in widths.items():
        if tensors[name].shape != (len(tensors["frame"]), width):
            raise ValueError(f"{sequence}: {name} has shape {tuple(tensors[name].shape)}, expected (N, {width})")
    # In one value: safetensors writes several in an order that changes from process to process.
    facts = json.dumps({"subject": subject, "object": object_name, **header})
    write_bytes(shard_path(root, sequence), save(tensors, {"header": facts}))


def read_header(path: str | Path, kind: Kind | None = None) -> dict[str, Any]:
    """What `write_shard` was given of a sequence besides its frames.

    Args:
        path: of the shard.
        kind: of what it must hold further, as in `grabnet.io.state`.

    Raises:
        UserError: a damaged or missing shard, or one of another format.
    """
    path, facts = Path(path), header_facts(path)
    try:
        return parsed_json((facts or {})["header"], _SHARD | (kind or {}))
    except (KeyError, ValueError) as error:
        raise UserError(f"{path} is damaged or missing ({error}): {_REMEDY}.") from None


def start_store(root: Path, recipe: Mapping[str, Any], remedy: str) -> None:
    """Make a store's folder ready for shards of a recipe; remove what a killed process left half-written there.

    Args:
        root: of the store.
        recipe: JSON-able record of all that decides a shard.
        remedy: for a store of another recipe; ends the sentence.

    Raises:
        UserError: the folder holds shards of another recipe, or of none.
    """
    path = root / "recipe.json"
    if not shard_names(root):
        path.unlink(missing_ok=True)  # nothing was made by it yet: a refused first try does not bind the next
    elif not path.exists():
        raise UserError(f"{root} holds frames without a record of what they were made from: {remedy}.")
    claim(path, recipe, remedy)
    clear_litter(root, "*.*", "shards/*/*.*")


def finish_store(
    root: str | Path,
    hand_sha256: str,
    v_template: dict[str, Tensor],
    objects: Iterable[str],
    provenance: dict[str, Any],
) -> None:
    """Make a store of the shards under `root`: subjects' hands, names, counts; written last, so that it means done.

    Args:
        root: of the store.
        hand_sha256: `HandModel.fingerprint` of the hand that the poses are for.
        v_template: (V, 3) rest right hand of each subject, by name.
        objects: names of all objects.
        provenance: JSON-able record of what the frames were made from and how.
    """
    root = Path(root)
    write_bytes(root / "subjects.safetensors", save({"v_template": torch.stack(list(v_template.values()))}))
    names = {"subjects": list(v_template), "objects": sorted(objects), "sequences": shard_names(root)}
    facts = {"format": FORMAT, "hand_sha256": hand_sha256}
    write_json(root / "store.json", facts | names | {"provenance": provenance})


def _read_shard(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    stored = read_tensors(path, "Shard", _REMEDY)
    widths = _VALUES | (_NOISE if "noise" in stored.values else {})
    check_tensors(stored, {"frame": ("N",)} | {name: ("N", width) for name, width in widths.items()}, _REMEDY)
    values = {name: stored.values[name].to(_TYPES.get(name, torch.float32)) for name in (*widths, "frame")}
    return fact(stored, "header", _SHARD, _REMEDY), values


def _true_hand(values: dict[str, Tensor]) -> Tensor:
    """(N, 51) global_orient, hand_pose and transl side by side."""
    return torch.cat([values["global_orient"], values["hand_pose"], values["transl"]], 1)


def _noise(noisy: Tensor, true: Tensor) -> Tensor:
    """(N, 51) what to add to true hands to have noisy ones; of the two ways to say a rotation the one nearest by."""
    (turns, place), (near, _) = ((x[:, :48].unflatten(1, (16, 3)), x[:, 48:]) for x in (noisy, true))
    reverse = turns * (1 - 2 * torch.pi / turns.norm(dim=2, keepdim=True).clamp_min(1e-8))
    is_nearer = (reverse - near).norm(dim=2, keepdim=True) < (turns - near).norm(dim=2, keepdim=True)
    return torch.cat([torch.where(is_nearer, reverse, turns).flatten(1), place], 1) - true
