"""README's section "With licensed files": its commands as they are printed, one after the other, on a mock of these
files that is made of the open hand and of shapes of our own."""

from __future__ import annotations

import json
import re
import shutil
import zipfile

import numpy as np
import pytest
import torch
import trimesh

from grabnet.data.frames import FramesStore
from grabnet.models.weights import read_conventions
from tests.data.published import hand_file, write_objects, write_release, zip_release
from tests.models.test_published import N_BPS, coarsenet_state, plausible, refinenet_state
from tests.preprocess.tiny_grab import write_grab
from tests.processes import ROOT, finish
from tests.readme import commands, words

# What makes each command short here, in the order of the page; a command of another beginning fails the test.
_NETWORK = [
    "data.batch_size=32", "data.object_points=64", "model.width=32", "model.n_hidden=16", "trainer.max_epochs=1",
    "callbacks.progress_bar=null", "callbacks.grasps=null",
]  # fmt: skip
_RELEASE = [*_NETWORK, "data.split.val=[ring]", "data.split.test=[block]", "data.root=data/release"]
SHORTER = [
    ("scripts/unpack_grab.py", []),
    ("train.py data=grabnet_release", [*_RELEASE, "model.bps.n_points=128", "run_dir=runs/coarsenet"]),
    ("train.py model=refinenet source=published", [*_RELEASE, "run_dir=runs/refinenet"]),
    ("scripts/preprocess.py data=grab", ["workers=1", "filter.min_finger_vertices=1"]),
    ("train.py data=frames", [*_NETWORK, "data.split.test=[mug]", "model.bps.n_points=128", "run_dir=runs/frames"]),
    ("scripts/import_checkpoint.py coarsenet", []),
    ("scripts/import_checkpoint.py refinenet", []),
    ("scripts/sample.py mesh=cup.obj model=runs/published", ["n=2", "optimise=2"]),
]


@pytest.fixture
def downloaded(tmp_path):
    """A folder with all that the section has one download, and a mesh of one's own."""
    grab, models, meshes = tmp_path / "mock" / "grab", tmp_path / "models", write_objects(tmp_path / "mock/meshes")
    write_grab(grab, models)
    (meshes / "ball.ply").unlink()  # GRAB's mock has another one
    frames = {
        "train": [("s1", "can_pass_1", k) for k in range(32)],
        "val": [("s1", "ring_lift_1", k) for k in range(2)],
        "test": [("s2", "block_use_1", k) for k in range(2)],
    }
    write_release(tmp_path / "mock/release", meshes, frames=frames)
    for mesh in (grab / "tools/object_meshes/contact_meshes").iterdir():
        shutil.copy(mesh, meshes)
    downloads = zip_release(tmp_path / "mock/release", meshes, tmp_path / "downloads")
    for folder in ("grab/s1", "grab/s2", "tools/subject_meshes/female"):
        with zipfile.ZipFile(downloads / f"{folder.replace('/', '__')}.zip", "w") as archive:
            for file in (grab / folder).iterdir():
                archive.write(file, file.name)
    shutil.rmtree(tmp_path / "mock")
    hand_file(tmp_path)
    coarse, fine = coarsenet_state(), refinenet_state()
    plausible(coarse, fine)
    torch.save(coarse, tmp_path / "coarsenet.pt")
    torch.save(fine, tmp_path / "refinenet.pt")
    basis = np.random.default_rng(0).normal(scale=0.07, size=(1, N_BPS, 3)).astype(np.float32)
    np.savez(tmp_path / "bps.npz", basis=basis)
    trimesh.creation.cylinder(0.035, 0.1).export(tmp_path / "cup.obj")
    return tmp_path


def test_its_commands_lead_from_downloads_to_grasps(downloaded):
    (section,) = re.findall(r"^## With licensed files\n(.*?)^## ", (ROOT / "README.md").read_text(), re.M | re.S)
    printed = commands(re.sub(r"^   ", "", section, flags=re.M))
    assert len(printed) == len(SHORTER)
    log = downloaded / "log.txt"
    for command, (beginning, shorter) in zip(printed, SHORTER, strict=True):
        python, script, *arguments = words(command)
        assert python == "python" and command.startswith(f"python {beginning}")
        assert finish([*arguments, *shorter], log, script=script, folder=downloaded) == 0, log.read_text()[-3000:]

    assert FramesStore.load(downloaded / "data/release/frames").objects == ["block", "can", "ring"]
    assert len(FramesStore.load(downloaded / "data/grab_frames/frames").frames) > 0
    for run in ("coarsenet", "refinenet", "frames"):
        metrics = json.loads((downloaded / "runs" / run / "metrics.json").read_text())
        assert np.isfinite(metrics["test/train/v2v"])
    assert read_conventions(downloaded / "runs/published/coarsenet").centre == "box"
    (record,) = downloaded.glob("**/cup/grasps.json")
    assert len(json.loads(record.read_text())["grasps"]) == 2
