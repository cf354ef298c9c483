"""The Lightning DataModule: loads a frames store once and hands out batches assembled on the device."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import lightning as L
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from grabnet.body.hand import HandModel
from grabnet.cli.checks import Count, Distance, Seed, Several, in_range
from grabnet.data.batches import BatchAssembler, GraspBatch
from grabnet.data.frames import Frames, FramesStore
from grabnet.data.measuring import compute_targets
from grabnet.data.objects import OBJECT_MESHES, ObjectSet
from grabnet.data.sources.base import FrameSource, write_store
from grabnet.data.splits import SPLITS, Split
from grabnet.data.targets import Targets
from grabnet.errors import UserError
from grabnet.geometry.conventions import Conventions


class GraspDataModule(L.LightningDataModule):
    """Frames of a store, split by the names of what they show.

    Args:
        hand: the hand model that the frames' poses are for.
        root: of the data set, laid out as GRAB is; the frames store is its folder `frames`.
        split: which frames are for training, validation and testing (ref. 3).
        objects_dir: folder with one mesh per object, `<name>.ply` (or .obj, .stl, …), in place of the data set's own.
        batch_size: frames per step, of all processes together.
        min_steps: of an epoch: few frames are gone through as often as that takes.
        centre: point of an object that its world has at the origin, as in `Conventions`.
        object_points: surface samples per object, which enter the object→hand loss.
        distance_to: hand→object distances are signed, to the "surface"; or unsigned, to the nearest of the "samples".
        basis_to: basis point sets hold distances to the "surface", or to the nearest of "samples", as in `Conventions`.
        points_in_use: vertices of an object that take the place of samples in use, and for `basis_to`.
        contact_distance: metres within which a hand vertex counts as touching (ref. 4).
        rotate: rotate training frames about the vertical at random.
        max_frames: use only so many training frames, evenly spaced; all when omitted.
        cache_dir: for signed-distance grids; the user's cache folder when omitted.
        seed: of sampling and shuffling.
        source: what the store and the objects' meshes are written from where they are missing.

    Attributes:
        conventions: how objects are shown to the network that is trained.

    Raises:
        UserError: a number out of range, or an unknown word.
    """

    def __init__(
        self,
        hand: HandModel,
        root: str,
        split: Split,
        objects_dir: str | None = None,
        batch_size: Several = 256,
        min_steps: Count = 1,
        centre: str = "mean_vertex",
        object_points: Count = 2048,
        distance_to: str = "surface",
        basis_to: str = "surface",
        points_in_use: Count = 10_000,
        contact_distance: Distance = 0.0045,
        rotate: bool = True,
        max_frames: Several | None = None,
        cache_dir: str | None = None,
        seed: Seed = 0,
        source: FrameSource | None = None,
    ):
        super().__init__()
        self.hand = hand
        self.root = Path(root)
        self.store_dir = self.root / "frames"
        self.split = split
        self.objects_dir = Path(objects_dir) if objects_dir else self.root / OBJECT_MESHES
        self.batch_size = batch_size
        self.min_steps = min_steps
        self.conventions = Conventions(
            centre, distance_to, basis_to, object_points, points_in_use, rotate, hand.fingerprint
        )
        self.object_points = object_points
        self.contact_distance = contact_distance
        self.rotate = rotate
        self.max_frames = max_frames
        self.cache_dir = cache_dir
        self.seed = seed
        self.source = source
        # Of one frame there are no batch statistics.
        in_range(self, "data.")
        self.assembler: BatchAssembler | None = None
        self._frames: dict[str, Frames] = {}
        self._targets: dict[str, Targets] = {}

    def prepare_data(self) -> None:
        if self.source is not None:
            self._refuse_other_hand(self.source.hand.fingerprint)
            write_store(self.root, self.source)

    @cached_property
    def store(self) -> FramesStore:
        """All frames.

        Raises:
            UserError: no store there, one that cannot be read, or one of another hand.
        """
        store = FramesStore.load(self.store_dir)
        self._refuse_other_hand(store.card["hand_sha256"])
        return store

    def _refuse_other_hand(self, fingerprint: str) -> None:
        """Raise a `UserError` where the frames' poses are for another hand than the model that is to be posed."""
        if fingerprint != self.hand.fingerprint:
            raise UserError(
                f"The frames in {self.store_dir} are of another hand ({fingerprint[:12]}) than hand_model "
                f"({self.hand.fingerprint[:12]}): give the one that they were made with, hand_model=open or "
                f"hand_model=mano hand_model.path=<its MANO_RIGHT.npz>."
            )

    def setup(self, stage: str | None = None) -> None:
        """Load the store and measure its frames; done once, whatever the stage."""
        if self.assembler is not None:
            return
        objects = ObjectSet.load(
            self.objects_dir,
            self.store.objects,
            conventions=self.conventions,
            seed=self.seed,
            cache_dir=self.cache_dir,
        )
        self.assembler = BatchAssembler(self.hand, self.store.v_template, objects)
        for split in SPLITS:
            frames = self.store.frames.select(self._members(split))
            least = 2 if split == "train" else 1  # batch norm takes no less
            if len(frames) < least:
                here = ", ".join(self.split.names(self.store))
                remedy = f"name some in data.split.{split}"
                if split == "train":
                    remedy = "leave some out of data.split.val and data.split.test"
                has = f"{self.store_dir} has {len(frames) or 'no'} {split} frames, where {least} must be"
                raise UserError(f"{has}; of its {self.split.by}s ({here}) {remedy}.")
            self._frames[split] = frames
            self._targets[split] = compute_targets(frames, self.assembler)

    @property
    def contact(self) -> Tensor:
        """(V,) share of training frames in which each hand vertex touches the object."""
        return self._targets["train"].contact(self.contact_distance)

    def part(self, split: str) -> FramesStore:
        """The store with all frames of train, val or test only; needs no `setup`."""
        return self.store.part(self.split.members(self.store, split))

    def frames(self, split: str) -> Frames:
        """The frames of train, val or test."""
        return self._frames[split]

    def record(self) -> dict[str, Any]:
        """What the data is, for a run's records."""
        return {
            "store": str(self.store_dir),
            "objects_sha256": self.assembler.object_set.sha256,
            "frames": {split: len(frames) for split, frames in self._frames.items()},
            "provenance": self.store.card["provenance"],
        }

    def train_dataloader(self) -> DataLoader:
        return self.loader("train", shuffle=True)

    def val_dataloader(self) -> DataLoader:
        return self.loader("val")

    def test_dataloader(self) -> list[DataLoader]:
        """All three splits: the paper reports its errors for each."""
        return [self.loader(split) for split in SPLITS]

    def loader(self, split: str, shuffle: bool = False) -> DataLoader:
        """Batches of frame numbers; `on_after_batch_transfer` makes `GraspBatch`es of them on the device.

        No workers: there is nothing to load, so that a step waits for no other process. Where a trainer runs in
        several processes, each gets its share of every batch.

        Raises:
            UserError: the batch size or the frames cannot be shared among the processes.
        """
        rank, world_size = (self.trainer.global_rank, self.trainer.world_size) if self.trainer else (0, 1)
        n = len(self._frames[split])
        if self.batch_size % world_size:
            raise UserError(
                f"data.batch_size={self.batch_size} cannot be shared evenly among {world_size} processes; "
                f"make it a multiple of {world_size}."
            )
        if n < world_size:
            raise UserError(f"The {n} {split} frames are too few for {world_size} processes; set trainer.devices={n}.")
        batches = IndexBatches(n, self.batch_size, shuffle, self.seed, rank, world_size, self.min_steps)
        return DataLoader(_FrameNumbers(split), sampler=batches, batch_size=None)

    def on_after_batch_transfer(self, batch: tuple[str, Tensor, int], dataloader_idx: int) -> GraspBatch:
        split, index, seed = batch
        torch.manual_seed(seed)  # all noise of the step follows from it, so that a resumed run repeats it
        return self.assemble(split, index, turn=self.rotate and self.trainer is not None and self.trainer.training)

    def assemble(self, split: str, index: Tensor, turn: bool = False) -> GraspBatch:
        """The frames `index` of a split as a batch on `index`'s device."""
        frames, targets = self._frames[split], self._targets[split]
        if frames.transl.device != index.device:
            frames = self._frames[split] = frames.to(index.device)
            targets = self._targets[split] = targets.to(index.device)
            self.assembler.to(index.device)
        return self.assembler(frames.select(index), targets.select(index), turn)

    def _members(self, split: str) -> Tensor:
        """Frame numbers of a split."""
        members = self.split.members(self.store, split)
        if split == "train" and self.max_frames is not None and self.max_frames < len(members):
            members = members[torch.linspace(0, len(members) - 1, self.max_frames).long()]
        return members


class IndexBatches(Sampler[tuple[Tensor, int]]):
    """One process's share of batches of numbers 0 … n - 1, each with a seed for its step's noise.

    Shuffled again each epoch, in full batches of equal shares, what is left over dropped, and again until there are
    `min_steps`; or once, in order and complete, in even pieces, as many in each process. All follows from seed and
    epoch alone, so that a resumed run goes on as an unbroken one would.

    Args:
        n: numbers to hand out, at least one per process.
        batch_size: of all processes together, a multiple of their number.
        rank, world_size: which process this is, of how many.
        min_steps: of an epoch, where shuffled.
    """

    def __init__(
        self,
        n: int,
        batch_size: int,
        shuffle: bool,
        seed: int,
        rank: int = 0,
        world_size: int = 1,
        min_steps: int = 1,
    ):
        self.n, self.shuffle, self.seed, self.rank, self.world_size = n, shuffle, seed, rank, world_size
        self.share = min(batch_size, n) // world_size
        per_process = n // world_size
        self.steps = per_process // self.share if shuffle else -(-per_process // self.share)  # of a pass
        self.passes = -(-min_steps // self.steps) if shuffle else 1
        self.epoch = 0

    def set_epoch(self, epoch: int) -> None:
        """Called by Lightning before each epoch."""
        self.epoch = epoch

    def __len__(self) -> int:
        return self.steps * self.passes

    def __iter__(self) -> Iterator[tuple[Tensor, int]]:
        # What is not shuffled meets the same noise in every epoch: its losses differ by the weights alone.
        epoch = self.epoch if self.shuffle else 0
        pieces = chain.from_iterable(self._pieces(epoch * self.passes + k) for k in range(self.passes))
        for k, piece in enumerate(pieces):
            yield piece, hash((self.seed, epoch, k * self.world_size + self.rank))

    def _pieces(self, number: int) -> Iterable[Tensor]:
        """Of one pass, the `number`th since training began."""
        if not self.shuffle:
            return torch.arange(self.n)[self.rank :: self.world_size].tensor_split(self.steps)
        order = torch.randperm(self.n, generator=torch.Generator().manual_seed(hash((self.seed, number))))
        batches = order[: self.steps * self.share * self.world_size].split(self.share * self.world_size)
        return [batch[self.rank :: self.world_size] for batch in batches]


class _FrameNumbers(Dataset):
    """Passes a batch of frame numbers and its seed through, labelled with its split."""

    def __init__(self, split: str):
        self.split = split

    def __getitem__(self, batch: tuple[Tensor, int]) -> tuple[str, Tensor, int]:
        index, seed = batch
        return self.split, index, seed
