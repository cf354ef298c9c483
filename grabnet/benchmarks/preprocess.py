"""From recordings of GRAB's size to a frames store, by one process and by two; and loading a store of GRAB's size."""

from __future__ import annotations

import atexit
import json
import shutil
import tempfile
from itertools import count
from pathlib import Path

import numpy as np
import torch
from hydra.utils import instantiate
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.scene import meshes
from grabnet.benchmarks.timing import Case
from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.body.skeleton import PARTS
from grabnet.cli.entry import compose
from grabnet.data.frames import FramesStore, finish_store, write_shard
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import BodyTrack, ContactTrack, HandTrack, RigidTrack, Sequence, write_sequence
from grabnet.geometry.bps import BPS
from grabnet.geometry.mesh import Mesh, save_mesh
from grabnet.preprocess.run import PreprocessConfig, preprocess

# As long as GRAB's are on average, of a body like SMPL-X's.
N_FRAMES, N_BODY = 1200, 10_475
# So many of them are enough to keep two workers busy.
N_RECORDINGS = 8
# Of the store that is loaded, in as many shards as GRAB has recordings; how many as published are loaded beside it.
N_LOADED, N_SHARDS, N_PUBLISHED = 300_000, 1334, 3_000
# Frames that are written as published.
N_WRITTEN = 100


def cases(settings: BenchmarkConfig) -> list[Case]:
    folder = Path(tempfile.mkdtemp(prefix="grabnet-benchmark-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    thing = meshes()[1]
    names = [f"s{k % 10 + 1}/torus_lift_{k + 1}" for k in range(N_RECORDINGS)]
    for k, name in enumerate(names):
        write_sequence(folder / "grab" / f"{name}.npz", _recording(name, thing, settings.seed + k))
    hand = HandModel.open()
    save_mesh(folder / OBJECT_MESHES / "torus.ply", thing)
    save_mesh(folder / "tools/hand.ply", Mesh(hand.v_template, hand.faces))

    numbers = count()

    def run(workers: int) -> Path:
        config = _config(folder, folder / f"output{next(numbers)}", workers)
        preprocess(config)
        return config.root

    trial = run(2)
    frames, peak = len(FramesStore.load(trial / "frames").frames), _peak_mb(trial)
    size = sum(path.stat().st_size for path in (trial / "frames").rglob("*.*")) / frames
    of, read = f"{len(names)} recordings of {N_FRAMES} frames", len(names) * N_FRAMES
    _write_many(folder / "many", trial / "frames")
    _write_published(folder / "published.npz")
    written = f"{N_WRITTEN} frames written as published"
    loaded = f"{N_PUBLISHED:,} frames loaded as published"
    return [
        Case(
            written, lambda: _as_published(FramesStore.load(trial / "frames"), thing, folder), runs=2, frames=N_WRITTEN
        ),
        Case(f"1 process: {of}", lambda: run(1), runs=2, frames=read),
        Case(
            f"2 processes of at most {peak} MB: {of}, {frames:,} kept at {size:.0f} bytes",
            lambda: run(2),
            (f"1 process: {of}",),
            runs=2,
            frames=read,
        ),
        Case(loaded, lambda: list(np.load(folder / "published.npz").values()), frames=N_PUBLISHED),
        Case(f"{N_LOADED:,} frames loaded", lambda: FramesStore.load(folder / "many"), (loaded,), frames=N_LOADED),
    ]


def _config(recordings: Path, output: Path, workers: int) -> PreprocessConfig:
    values = {
        "data": "grab",
        "data.root": recordings,
        "data.models": OPEN_HANDS,
        "output": output,
        "cache_dir": recordings / "cache",
        "workers": workers,
        "pictures": "false",
    }
    config = compose("preprocess/preprocess", [f"{key}={value}" for key, value in values.items()])
    return instantiate(config, _convert_="all")


def _peak_mb(output: Path) -> int:
    return max(json.loads((output / "run.json").read_text())["peak_mb_of_workers"].values())


def _recording(name: str, thing: Mesh, seed: int) -> Sequence:
    """The right hand takes a thing after a third of the time and lifts it; in numbers, not in looks."""
    rng = np.random.default_rng(seed)

    def track(*widths: int) -> list[np.ndarray]:
        return [rng.normal(0, 0.1, (N_FRAMES, width)).astype(np.float32) for width in widths]

    transl, orient = track(3, 3)
    transl[:, 2] = 0.0002 * np.maximum(np.arange(N_FRAMES) - N_FRAMES // 3, 0)
    labels, body = (np.zeros((N_FRAMES, n), np.uint8) for n in (len(thing.vertices), N_BODY))
    held = slice(N_FRAMES // 3, None)
    for k, part in enumerate((PARTS["right_index3"], PARTS["right_middle3"], PARTS["right_thumb3"])):
        labels[held, 100 * k : 100 * (k + 1)] = body[held, 100 * k : 100 * (k + 1)] = part
    hand = HandTrack(*track(3, 24, 3, 45), "tools/hand.ply")
    return Sequence(
        name=name,
        gender="female",
        sbj_id=name.split("/")[0],
        obj_name="torus",
        motion_intent="lift",
        framerate=120.0,
        n_comps=24,
        body=BodyTrack(*track(3, 3, 63, 3, 3, 3, 24, 24, 165, 10), "tools/body.ply"),
        rhand=hand,
        lhand=hand,
        object=RigidTrack(transl, orient, str(OBJECT_MESHES / "torus.ply")),
        table=RigidTrack(transl, orient, str(OBJECT_MESHES / "table.ply")),
        contact=ContactTrack(labels, body),
    )


def _write_many(root: Path, store: Path) -> None:
    """A store of `N_LOADED` frames, those of another over and over."""
    frames = FramesStore.load(store).frames
    index = torch.arange(N_LOADED) % len(frames)
    for k, part in enumerate(index.tensor_split(N_SHARDS)):
        chosen = frames.select(part)
        values = {n: getattr(chosen, n) for n in ("global_orient", "hand_pose", "transl", "object_orient", "frame")}
        write_shard(root, f"s1/torus_lift_{k}", "s1", "torus", values)
    hand = HandModel.open()
    finish_store(root, hand.fingerprint, {"s1": hand.v_template}, ["torus"], {})


def _write_published(path: Path) -> None:
    rng = np.random.default_rng(0)
    shapes = {"verts_rhand": (778, 3), "verts_object": (2048, 3), "bps_object": (4096,)}
    np.savez(path, **{n: rng.normal(size=(N_PUBLISHED, *shape)).astype(np.float32) for n, shape in shapes.items()})


def _as_published(store: FramesStore, thing: Mesh, folder: Path) -> None:
    """What published data hold of a frame, made one after the other: both surfaces' points and the basis point set."""
    hand, basis = HandModel.open(), BPS().basis.numpy()
    points = thing.sample_surface(2048)[0] - thing.centroid
    frames = store.frames.select(torch.arange(N_WRITTEN))
    parameters, turns = frames.hand(), frames.object_orient
    for k in range(N_WRITTEN):
        cloud = Rotation.from_rotvec(turns[k].numpy()).apply(points)
        vertices = hand(parameters.select(slice(k, k + 1))).vertices[0].numpy()
        np.savez(folder / "frame.npz", hand=vertices, object=cloud, bps=cKDTree(cloud).query(basis)[0])
