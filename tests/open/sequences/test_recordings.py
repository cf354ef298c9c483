"""Recordings of each intent, made here and read back as anyone would read GRAB's."""

from __future__ import annotations

import contextlib
import io

import numpy as np
import pytest
import smplx
import torch

from grabnet.body.hand import OPEN_HANDS, HandModel
from grabnet.body.skeleton import LEFT_HAND_PARTS, RIGHT_HAND_PARTS
from grabnet.body.whole import OPEN_BODY, BodyModel
from grabnet.contact.annotator import vertex_parts
from grabnet.data.intents import intent_of
from grabnet.data.objects import OBJECT_MESHES
from grabnet.data.sequences import load_below, read_sequence
from grabnet.errors import UserError
from grabnet.geometry.mesh import save_mesh
from grabnet.io.files import sha256, write_json
from grabnet.io.npz import read_npz
from grabnet.open.body.subjects import open_subjects, write_subjects
from grabnet.open.grasps.store import OPEN_GRASPS, load_open_grasps
from grabnet.open.objects import build_object
from grabnet.open.sequences import building
from grabnet.open.sequences.building import TWO_HANDED, Entry, build_sequences, record, schedule
from grabnet.open.sequences.uses import USES
from grabnet.open.sequences.writing import write_table
from grabnet.preprocess.filtering import FrameFilter
from grabnet.preprocess.grasp_track import GraspTrack

# As configs/preprocess/filter/open.yaml: the paper's rules, for meshes of fewer vertices.
RULES = FrameFilter(True, True, 0.005, True, 1, 12, 1, "frame0", False)
ENTRIES = [
    Entry(0, "s7/cylindermedium_lift_1", "s7", "cylindermedium", "lift"),
    Entry(1, "s7/cylindermedium_pass_1", "s7", "cylindermedium", "pass"),
]


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A small data set: one object, two intents."""
    root = tmp_path_factory.mktemp("open")
    (root / OBJECT_MESHES).mkdir(parents=True)
    for name in sorted({entry.object for entry in ENTRIES}):
        save_mesh(root / OBJECT_MESHES / f"{name}.ply", build_object(name))
    body = BodyModel.open()
    people = open_subjects(body, load_open_grasps())
    write_subjects(root, body, [s for s in people if s.name in {entry.subject for entry in ENTRIES}])
    write_table(root)
    for entry in ENTRIES:
        assert "given_up" not in record(entry, root, seed=0)
    return root


@pytest.fixture(scope="module", params=ENTRIES, ids=lambda entry: entry.intent)
def entry(request):
    return request.param


@pytest.fixture(scope="module")
def sequence(root, entry):
    return read_sequence(root / "grab" / f"{entry.name}.npz", [entry.object])


@pytest.fixture(scope="module")
def people(root, sequence):
    """(T, V, 3) of the body, posed from what the file names."""
    body = BodyModel.open()
    v_template = torch.tensor(load_below(root, sequence.body.vtemp).vertices)
    return body(sequence.body.parameters(), v_template).vertices.numpy()


def test_starts_and_ends_in_t_pose(sequence):
    assert np.abs(sequence.body.body_pose[[0, -1]]).max() < 1e-5
    assert np.abs(sequence.body.fullpose[[0, -1], 75:]).max() < 1e-5
    assert sequence.framerate == 120 and 300 < len(sequence) < 1800


def test_nothing_jumps(sequence, people):
    assert np.linalg.norm(np.diff(people, axis=0), axis=-1).max() < 0.02
    rotations = sequence.body.parameters().rotations
    relative = rotations[:-1].mT @ rotations[1:]
    cosine = (relative.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    assert torch.rad2deg(torch.arccos(cosine.clamp(-1, 1))).max() < 15
    assert np.linalg.norm(np.diff(sequence.object.transl, axis=0), axis=-1).max() < 0.02


def test_feet_stand_still_on_the_floor(people):
    soles = people[0, :, 2] < 0.03
    assert people[..., 2].min() > -0.002
    assert np.abs(people[:, soles] - people[0, soles]).max() < 0.001


def test_the_object_rests_on_the_table_and_leaves_it_in_a_hand(root, sequence):
    mesh = load_below(root, sequence.object.mesh)
    lowest = sequence.object.to_world(torch.as_tensor(mesh.vertices)).amin(1)[:, 2].numpy()
    top = sequence.table.transl[:, 2]
    assert 0.749 < top[0] < 1.201
    assert abs(lowest[0] - top[0]) < 0.001 and (lowest > top - 0.001).all()
    lifted = lowest - top > 0.002
    assert lifted.sum() > 120
    touched = np.isin(sequence.contact.object, (*LEFT_HAND_PARTS, *RIGHT_HAND_PARTS)).any(1)
    assert touched[lifted].all()
    still = np.linalg.norm(np.diff(sequence.object.transl, axis=0), axis=-1) < 1e-6
    assert still[~lifted[1:] & ~lifted[:-1]].mean() > 0.9


def test_the_object_is_held_rigidly(sequence, entry):
    """In the frame of the wrist that holds it, it does not move."""
    track = sequence.lhand if entry.intent == "offhand" else sequence.rhand
    rotations = track.parameters().global_orient.double().numpy()
    inside = (np.swapaxes(rotations, 1, 2) @ (sequence.object.transl - track.transl)[..., None])[..., 0]
    lifted = sequence.object.transl[:, 2] - sequence.object.transl[0, 2] > 0.01
    rising = lifted[1:] & lifted[:-1] & (np.diff(sequence.object.transl[:, 2]) > 1e-4)
    first_rise = rising.nonzero()[0][:20]  # while it goes up, whoever holds it is the one who took it
    origin = HandModel.open().rest_joints(torch.zeros(778, 3))[0].numpy()
    assert np.linalg.norm(np.diff(inside + origin, axis=0)[first_rise], axis=1).max() < 0.02
    relative = np.swapaxes(rotations, 1, 2) @ sequence.object.rotations().double().numpy()
    assert np.abs(np.diff(relative, axis=0)[first_rise]).max() < 1e-4


def test_hands_alone_are_where_the_bodys_are(root, sequence, people):
    """But for the skin about the wrist, which only the body shares with a forearm."""
    stored = read_npz(OPEN_BODY / "subjects.npz")
    for side, track in (("right", sequence.rhand), ("left", sequence.lhand)):
        hand = HandModel.open(side)
        rest = torch.as_tensor(load_below(root, track.vtemp).vertices)
        alone = hand(track.parameters(), rest).vertices.numpy()
        own = people[:, stored[f"{side[0]}hand_vertices"].astype(int)]
        apart = np.linalg.norm(alone - own, axis=-1)
        beyond_wrist = hand.weights[:, 1:].sum(1).numpy() > 0.5
        assert apart[:, beyond_wrist].max() < 3e-4
        assert np.median(apart) < 1e-4


def test_smplx_reads_bodies_and_hands_as_users_of_grab_read_them(root, entry, sequence, people):
    """Bodies by the package's defaults, hands on a flat mean, components as many as the file says."""
    with np.load(root / "grab" / f"{entry.name}.npz", allow_pickle=True) as file:
        stored = {name: file[name].item() for name in ("body", "rhand", "lhand", "n_comps", "n_frames")}
    options = {"ext": "npz", "num_pca_comps": stored["n_comps"], "batch_size": stored["n_frames"]}

    def vertices(model_file, kind, track, **more):
        template = load_below(root, track["vtemp"]).vertices
        with contextlib.redirect_stdout(io.StringIO()), torch.no_grad():
            model = smplx.create(str(model_file), kind, v_template=template, **options, **more)
            return model(**{k: torch.tensor(v) for k, v in track["params"].items() if k != "fullpose"}).vertices.numpy()

    body = vertices(OPEN_BODY / "SMPLX_NEUTRAL.npz", "smplx", stored["body"])
    np.testing.assert_allclose(body, people, atol=1e-5)
    for side, name, track in (("right", "rhand", sequence.rhand), ("left", "lhand", sequence.lhand)):
        hand, rest = HandModel.open(side), torch.tensor(load_below(root, track.vtemp).vertices)
        expected = hand(track.parameters(), rest).vertices.numpy()
        read = vertices(
            OPEN_HANDS / f"MANO_{side.upper()}.npz", "mano", stored[name], is_rhand=side == "right", flat_hand_mean=True
        )
        np.testing.assert_allclose(read, expected, atol=1e-5)


def test_the_intent_is_the_action_as_grab_has_it(sequence, entry):
    assert sequence.motion_intent == entry.name.split("_")[1]


def test_stored_contact_is_by_the_right_parts(sequence, entry):
    parts = vertex_parts(BodyModel.open().weights.numpy())
    labels = sequence.contact.body
    assert ((labels == 0) | (labels == parts)).all()
    seen = set(np.unique(sequence.contact.object)) - {0}
    assert seen <= set(LEFT_HAND_PARTS) | set(RIGHT_HAND_PARTS)
    assert bool(seen & set(LEFT_HAND_PARTS)) == (entry.intent == "offhand")


def test_the_filter_finds_grasps(sequence, entry):
    """Many frames of a lift or a pass; of a hand-over those after the left hand let go."""
    kept = np.logical_and.reduce(list(RULES.passed(GraspTrack.right(sequence)).values())).nonzero()[0]
    assert len(kept) > (120 if entry.intent != "offhand" else 60)
    if entry.intent == "offhand":
        assert kept[0] > len(sequence) // 3


def test_same_seed_same_bytes(root, tmp_path):
    (tmp_path / "tools").symlink_to(root / "tools")
    record(ENTRIES[1], tmp_path, seed=0)
    assert sha256(tmp_path / "grab" / f"{ENTRIES[1].name}.npz") == sha256(root / "grab" / f"{ENTRIES[1].name}.npz")


def test_schedule_of_fewer_is_the_start_of_more():
    grasps = load_open_grasps()
    many = schedule(grasps, 150, 0, grasps.subjects)
    assert many[:40] == schedule(grasps, 40, 0, grasps.subjects)
    assert len({entry.name for entry in many}) == 150
    assert {entry.object for entry in many[: len(grasps.objects)]} == set(grasps.objects)
    assert {entry.intent for entry in many} == {"use", "pass", "lift", "offhand"}
    assert all(intent_of(entry.action) == entry.intent for entry in many)
    assert {entry.action for entry in many if entry.object == "mug" and entry.intent == "use"} == {"drink"}
    assert {entry.subject for entry in many} == set(grasps.subjects)
    assert {e.subject for e in schedule(grasps, 20, 0, ("s2", "s9"))} == {"s2", "s9"}


def test_uses_and_two_handed_objects_exist():
    names = set(load_open_grasps().objects)
    assert set(USES) <= names and names >= TWO_HANDED


def test_nonsense_is_refused(tmp_path):
    with pytest.raises(UserError, match="--number 0"):
        build_sequences(tmp_path, 0)
    with pytest.raises(UserError, match="no subject s11; choose from s1"):
        build_sequences(tmp_path, 1, subjects=["s11"])


@pytest.mark.parametrize("changed", ["seed", "format"])
def test_sequences_of_another_recipe_are_not_mixed(tmp_path, changed):
    grasps = load_open_grasps()
    recipe = {
        "format": building.FORMAT,
        "seed": 0,
        "subjects": list(grasps.subjects),
        "grasps_sha256": sha256(OPEN_GRASPS),
        "body_sha256": sha256(OPEN_BODY / "SMPLX_NEUTRAL.npz", OPEN_BODY / "subjects.npz"),
    }
    write_json(tmp_path / "reports" / "recipe.json", recipe | {changed: 9})
    sentence = rf"was started with {changed}=9, now it is {recipe[changed]}: choose another --root"
    with pytest.raises(UserError, match=sentence):
        build_sequences(tmp_path, 1)
