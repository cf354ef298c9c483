"""Another data set in one file: written into a store on first use, continued after a kill, trained on."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from grabnet.body.hand import OPEN_HANDS, HandModel, HandParameters
from grabnet.cli.entry import compose
from grabnet.data.datamodule import GraspDataModule
from grabnet.data.frames import FramesStore
from grabnet.data.sources.base import FrameSource, HandFrames, write_store
from grabnet.data.splits import Split
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh, load_mesh, save_mesh
from grabnet.io.npz import read_npz
from grabnet.training.run import train
from tests.faults import DiesPublishing
from tests.processes import finish
from tests.tiny import tiny_overrides

SEQUENCES = [f"p{k}/{name}_lift_{k}" for k in range(3) for name in ("egg", "jar", "pen", "pot")]
N = 6


class Toy(FrameSource):
    """Three people, known by their betas alone, hold four boxes that are modelled off their frames' origins.

    Args:
        folder: where the meshes are made.
        hand: MANO's, or the open one.
        spoil: changes what is read.
    """

    FORMAT = 1

    def __init__(self, folder: str, hand: HandModel, spoil: Callable[[HandFrames], HandFrames] | None = None):
        self.folder = Path(folder)
        self.hand = hand
        self.spoil = spoil
        self.n_read = 0

    def recipe(self):
        return {"source": "toy", "format": self.FORMAT}

    def objects(self):
        paths = {name: self.folder / f"{name}.obj" for name in ("egg", "jar", "pen", "pot")}
        for k, path in enumerate(paths.values()):
            box = trimesh.creation.box((0.04, 0.05, 0.06 + 0.01 * k)).subdivide().subdivide()
            save_mesh(path, Mesh(box.vertices + np.array([0.5, -0.2, 0.1 * k]), box.faces))
        return paths

    def subjects(self):
        return {f"p{k}": self.hand.shaped(torch.tensor([0.5 * k, -1.0])) for k in range(3)}

    def sequences(self):
        return SEQUENCES

    def read(self, sequence):
        self.n_read += 1
        subject, take = sequence.split("/")
        rng = np.random.default_rng(SEQUENCES.index(sequence))
        joints = Rotation.from_rotvec(rng.normal(0, 0.3, (N * 16, 3))).as_matrix().reshape(N, 16, 3, 3)
        turns = Rotation.random(N, rng).as_matrix()
        hand = HandParameters.from_rotations(
            torch.tensor(joints).float(), torch.tensor(rng.normal(0, 1, (N, 3))).float()
        )
        frames = HandFrames(
            subject=subject,
            object=take.split("_")[0],
            intent="lift",
            frame=10 * torch.arange(N),
            hand=hand,
            object_rotation=torch.tensor(turns).float(),
            object_transl=torch.tensor(rng.normal(0, 1, (N, 3))).float(),
        )
        return frames if self.spoil is None else self.spoil(frames)

    def facts(self):
        return {"licence": "none"}


def overrides(root: Path, run_dir: Path, cache_dir: Path) -> list[str]:
    source = f"{{_target_: {Toy.__module__}.Toy, folder: {root / 'source'}, hand: ${{hand_model}}}}"
    values = tiny_overrides(root, run_dir, cache_dir, "coarsenet", "trainer.max_epochs=1", "callbacks.grasps=null")
    split = ["data.split.by=subject", "data.split.val=[p1]", "data.split.test=[p2]", "data.batch_size=8"]
    return [*(value for value in values if "split" not in value), *split, f"data.source={source}"]


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture(scope="module")
def written(tmp_path_factory, hand):
    root = tmp_path_factory.mktemp("toy")
    write_store(root, Toy(str(root / "source"), hand))
    return root


def test_the_store_shows_what_was_read_about_the_centroids(written, hand):
    store, source = FramesStore.load(written / "frames"), Toy(str(written / "source"), hand)
    assert store.subjects == ["p0", "p1", "p2"] and store.objects == ["egg", "jar", "pen", "pot"]
    assert store.card["hand_sha256"] == hand.fingerprint and store.card["provenance"]["licence"] == "none"
    meshes = source.objects()
    for number, name in enumerate(store.sequences):
        frames, expected = store.frames.select(store.frames.sequence == number), source.read(name)
        rest = store.v_template[frames.subject]
        assert torch.equal(rest[0], source.subjects()[expected.subject])
        vertices = load_mesh(meshes[expected.object]).vertices
        centre = vertices.mean(0) @ expected.object_rotation.mT.numpy() + expected.object_transl.numpy()
        world = hand(expected.hand, rest).vertices.numpy() - centre[:, None]
        np.testing.assert_allclose(hand(frames.hand(), rest).vertices, world, atol=2e-5)
        turned = Rotation.from_rotvec(frames.object_orient).as_matrix()
        np.testing.assert_allclose(turned, expected.object_rotation, atol=1e-5)
        assert frames.frame.tolist() == expected.frame.tolist()


def test_it_is_trained_on_by_the_command_that_writes_it(tmp_path, cache_dir):
    metrics = train(compose("train", overrides(tmp_path / "toy", tmp_path / "run", cache_dir)))
    assert metrics["test/val/v2v"] > 0
    assert len(FramesStore.load(tmp_path / "toy/frames").frames) == N * len(SEQUENCES)


def test_batches_are_split_by_people(written, hand, cache_dir):
    data = GraspDataModule(
        hand, str(written), Split("subject", ["p1"], ["p2"]), object_points=64, cache_dir=str(cache_dir),
        source=Toy(str(written / "source"), hand),
    )  # fmt: skip
    data.prepare_data()
    data.setup()
    for split, subject in (("train", 0), ("val", 1), ("test", 2)):
        assert data.frames(split).subject.unique().tolist() == [subject]
        assert torch.equal(data.part(split).frames.subject, data.frames(split).subject)
    batch = data.assemble("train", torch.arange(4))
    assert batch.vertices.shape == (4, 778, 3) and batch.distances.isfinite().all()


def test_a_killed_command_is_continued_to_the_same_bytes(written, tmp_path, cache_dir, hand):
    root, log = tmp_path / "toy", tmp_path / "log.txt"
    command = overrides(root, tmp_path / "run", cache_dir)
    assert finish(command, log, DiesPublishing("*/shards/*", 5)) == -signal.SIGKILL, log.read_text()
    assert len(list((root / "frames/shards").rglob("[!.]*.safetensors"))) == 4
    assert list((root / "frames/shards").rglob(".*.safetensors"))  # half of the fifth
    source = Toy(str(root / "source"), hand)
    write_store(root, source)
    assert source.n_read == len(SEQUENCES) - 4
    assert files_of(root) == files_of(written)


def test_it_is_written_once_by_whoever_comes_first(tmp_path, hand):
    sources = [Toy(str(tmp_path / f"source{k}"), hand) for k in range(3)]
    threads = [threading.Thread(target=write_store, args=(tmp_path / "toy", source)) for source in sources]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(source.n_read for source in sources) == [0, 0, len(SEQUENCES)]


def test_another_format_is_refused(tmp_path, hand, monkeypatch):
    def interrupt(frames):
        if frames.object == "pen":
            raise KeyboardInterrupt
        return frames

    with pytest.raises(KeyboardInterrupt):
        write_store(tmp_path, Toy(str(tmp_path / "source"), hand, interrupt))
    before = files_of(tmp_path)
    monkeypatch.setattr(Toy, "FORMAT", 2)
    sentence = r"frames was started with format=1, now it is 2: delete .*frames, or choose another data\.root\."
    with pytest.raises(UserError, match=sentence):
        write_store(tmp_path, Toy(str(tmp_path / "source"), hand))
    assert files_of(tmp_path) == before


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (
            lambda f: f._replace(subject="p9"),
            "p0/egg_lift_0 shows the subject p9, which is unknown; there are p0, p1, p2",
        ),
        (lambda f: f._replace(object="cup"), "shows the object cup, which is unknown; there are egg, jar, pen, pot"),
        (lambda f: f._replace(object_transl=f.object_transl * torch.nan), "p0/egg_lift_0: its object is not finite"),
        (lambda f: f._replace(hand=f.hand._replace(transl=f.hand.transl / 0)), "its hand is not finite"),
        (lambda f: f._replace(object_rotation=2 * f.object_rotation), "of its object are no rotation matrices"),
        (lambda f: f._replace(object_rotation=-f.object_rotation), "of its object are no rotation matrices"),
        (lambda f: f._replace(noisy=f.hand._replace(hand_pose=1.1 * f.hand.hand_pose)), "of its hand are no rotation"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, hand, spoil, sentence):
    with pytest.raises(UserError, match=sentence):
        write_store(tmp_path, Toy(str(tmp_path / "source"), hand, spoil))
    assert not (tmp_path / "frames/store.json").exists()


@pytest.mark.parametrize("name", ["egg_lift_1", "p0/../egg", "../../egg_lift_1", "p0/", "p0/.egg"])
def test_names_that_lead_elsewhere_are_refused(tmp_path, hand, monkeypatch, name):
    source = Toy(str(tmp_path / "source"), hand)
    frames = source.read(SEQUENCES[0])
    monkeypatch.setattr(source, "sequences", lambda: [name])
    monkeypatch.setattr(source, "read", lambda sequence: frames)
    with pytest.raises(UserError, match="cannot name a sequence: it must be like s1/mug_lift_1"):
        write_store(tmp_path / "toy", source)
    assert not list(tmp_path.rglob("*.safetensors"))


@pytest.fixture
def other_hand(tmp_path):
    """The open hand with joints elsewhere; in its template it is the same."""
    arrays = read_npz(OPEN_HANDS / "MANO_RIGHT.npz")
    np.savez(tmp_path / "MANO_RIGHT.npz", **arrays | {"J_regressor": np.roll(arrays["J_regressor"], 1, axis=1)})
    return tmp_path / "MANO_RIGHT.npz"


@pytest.mark.parametrize("is_written", [True, False])
def test_training_with_another_hand_is_refused(written, other_hand, tmp_path, cache_dir, hand, is_written):
    """Of a store that is there, and before one is made from a source."""
    with pytest.raises(UserError) as error:
        if is_written:
            values = [o for o in overrides(written, tmp_path / "run", cache_dir) if "data.source" not in o]
            train(compose("train", [*values, "hand_model=mano", f"hand_model.path={other_hand}"]))
        else:
            source = Toy(str(tmp_path / "source"), hand)
            GraspDataModule(
                HandModel(other_hand), str(tmp_path / "toy"), Split("subject", [], []), source=source
            ).prepare_data()
    root = written if is_written else tmp_path / "toy"
    names = rf"The frames in {root}/frames are of another hand \({hand.fingerprint[:12]}\) than hand_model \(\w{{12}}\)"
    assert error.match(names + ": give the one that they were made with, hand_model=open or hand_model=mano")
    assert not (tmp_path / "toy").exists()


def test_a_store_without_a_record_is_not_continued(written, tmp_path, hand):
    target = tmp_path / "frames/shards/p0/egg_lift_0.safetensors"
    target.parent.mkdir(parents=True)
    target.write_bytes((written / "frames/shards/p0/egg_lift_0.safetensors").read_bytes())
    with pytest.raises(UserError, match="holds frames without a record of what they were made from: delete"):
        write_store(tmp_path, Toy(str(tmp_path / "source"), hand))
