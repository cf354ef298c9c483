from __future__ import annotations

import pytest
import torch

from grabnet.body.hand import OPEN_HANDS
from grabnet.errors import UserError
from grabnet.geometry.queries import MeshQuery
from grabnet.geometry.rotations import random_rotations
from grabnet.grasping.grasp_hand import GraspPose
from grabnet.io.files import sha256
from grabnet.open.grasps.building import collect
from grabnet.open.grasps.store import OPEN_GRASPS, load_open_grasps, save_open_grasps
from grabnet.open.grasps.synthesise import SUBJECTS, ObjectGrasps, SynthesisConfig, subject_betas
from grabnet.open.objects import OBJECTS, build_object

CONFIG = SynthesisConfig()


def some_grasps(name: str, n: int) -> ObjectGrasps:
    generator = torch.Generator().manual_seed(n)
    pose = GraspPose(random_rotations(n, generator), torch.rand(n, 3), torch.rand(n, 21, generator=generator))
    index = torch.arange(n)
    return ObjectGrasps(name, "0" * 64, index % 10, index % 5, index % 2 == 0, pose, torch.rand(n, 3), {})


def test_what_is_written_is_read(tmp_path, anatomy):
    found = [some_grasps("mug", 7), some_grasps("apple", 4)]
    grasps = collect(found, subject_betas(CONFIG, 0), CONFIG, seed=5)
    save_open_grasps(tmp_path / "grasps.safetensors", grasps)
    again = load_open_grasps(tmp_path / "grasps.safetensors")
    assert again.objects == ("apple", "mug") and again.subjects == SUBJECTS and len(again) == 11
    assert again.meta["seed"] == 5 and again.meta["config"]["per_object"] == CONFIG.per_object
    for name in ("object", "subject", "kind", "clears_table", "transl", "betas"):
        assert torch.equal(getattr(again, name), getattr(grasps, name))
    torch.testing.assert_close(again.angles, grasps.angles, atol=1e-3, rtol=0)
    parameters = again.parameters(anatomy, again.object == 1)
    torch.testing.assert_close(parameters.global_orient, found[0].pose.rotation)
    torch.testing.assert_close(parameters.transl, found[0].transl)


def test_missing_and_damaged_files_are_told(tmp_path):
    with pytest.raises(UserError, match="does not exist"):
        load_open_grasps(tmp_path / "grasps.safetensors")
    (tmp_path / "grasps.safetensors").write_bytes(b"nonsense")
    with pytest.raises(UserError, match="build_open"):
        load_open_grasps(tmp_path / "grasps.safetensors")


@pytest.fixture(scope="module")
def shipped():
    return load_open_grasps()


def test_all_objects_and_subjects_are_there_in_equal_shares(shipped):
    assert shipped.objects == tuple(sorted(OBJECTS)) and len(shipped.subjects) == 10
    assert len(shipped) >= 10_000
    per_object = shipped.object.bincount(minlength=len(OBJECTS))
    assert per_object.min() > 0.4 * per_object.max()
    per_subject = shipped.subject.bincount(minlength=10)
    assert per_subject.min() > 0.7 * per_subject.max()
    assert 0.35 < shipped.clears_table.float().mean() < 0.75
    assert (shipped.kind.bincount(minlength=len(shipped.kinds)) > 100).all()
    assert OPEN_GRASPS.stat().st_size < 3_000_000


def test_the_grasps_are_of_this_hand(shipped):
    assert shipped.meta["hand_sha256"] == sha256(OPEN_HANDS / "MANO_RIGHT.npz")


def test_angles_keep_to_the_limits(shipped, limits):
    assert (shipped.angles > limits[:, 0] - 1e-3).all() and (shipped.angles < limits[:, 1] + 1e-3).all()


def test_contact_and_penetration_hold_by_exact_queries(shipped, model, anatomy):
    generator = torch.Generator().manual_seed(0)
    deepest = []
    for number in torch.randperm(len(shipped.objects), generator=generator)[:6].tolist():
        mesh = build_object(shipped.objects[number])
        query = MeshQuery(mesh)
        rows = torch.where(shipped.object == number)[0]
        rows = rows[torch.randperm(len(rows), generator=generator)[:12]]
        vertices = model(shipped.parameters(anatomy, rows), model.shaped(shipped.betas[shipped.subject[rows]])).vertices
        distance = query.signed_distance(vertices.reshape(-1, 3), 0.02).view(len(rows), -1)
        deepest.append(-distance.amin(1))
        assert (distance[:, anatomy.finger == 0].amin(1) < 0.0045).all()
        assert (distance[:, anatomy.finger > 0].amin(1) < 0.0045).all()
        on_table = shipped.clears_table[rows]
        assert (vertices[on_table, :, 2] > mesh.vertices[:, 2].min() - 0.002).all()
    deepest = torch.cat(deepest)
    assert deepest.max() < 0.005 and deepest.mean() < 0.0025
