"""The frame filter: each rule at its threshold, and frames that arrive in the store as they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from hydra.utils import instantiate
from omegaconf import OmegaConf
from scipy.spatial.transform import Rotation

from grabnet.body.hand import HandModel
from grabnet.cli.checking import check
from grabnet.cli.entry import CONFIGS
from grabnet.data.frames import FramesStore, finish_store
from grabnet.data.sequences import ContactTrack, RigidTrack
from grabnet.data.sources.base import write_frames
from grabnet.preprocess.filtering import Waterfall, frames_left
from grabnet.preprocess.grasp_track import GraspTrack
from tests.data.grab import random_sequence


def paper(**changes):
    config = OmegaConf.load(CONFIGS / "preprocess/filter/paper.yaml")
    check(config)
    return instantiate(config, **changes)


def sequence(frames):
    """One frame for each of (height in metres, {label: vertices}), after a first one at height 0 without contact."""
    frames = [(0.0, {}), *frames]
    labels = np.zeros((len(frames), 400), np.uint8)
    transl = np.zeros((len(frames), 3), np.float32)
    for row, (height, parts) in enumerate(frames):
        filled = np.concatenate([np.full(n, part) for part, n in parts.items()]) if parts else np.zeros(0)
        labels[row, : len(filled)] = filled
        transl[row, 2] = height
    made = random_sequence(len(frames), 400)
    contact = ContactTrack(labels, made.contact.body)
    thing = RigidTrack(transl, made.object.global_orient, made.object.mesh)
    return GraspTrack.right(replace(made, contact=contact, object=thing))


def kept(rules, track):
    return np.logical_and.reduce(list(rules.passed(track).values())).nonzero()[0].tolist()


THUMB_AND_INDEX = {53: 20, 54: 30, 41: 50}


@pytest.mark.parametrize(
    ("height", "parts", "expected"),
    [
        (0.02, THUMB_AND_INDEX, True),
        (-0.02, THUMB_AND_INDEX, True),  # lower than at first
        (0.0051, THUMB_AND_INDEX, True),
        (0.0049, THUMB_AND_INDEX, False),
        (0.02, {53: 20, 54: 29, 41: 50}, False),  # 49 vertices under the thumb
        (0.02, {55: 50, 51: 25, 52: 25}, True),  # ring finger
        (0.02, {55: 50, 49: 49}, False),  # 49 under the pinky
        (0.02, {55: 50, 41: 25, 44: 25}, False),  # 25 each under index and middle
        (0.02, {41: 50, 44: 50}, False),  # no thumb
        (0.02, {53: 100}, False),  # the thumb alone
        (0.02, {53: 50, 22: 100}, False),  # the palm is no finger
        (0.02, THUMB_AND_INDEX | {21: 1}, False),  # one vertex of the left palm
        (0.02, THUMB_AND_INDEX | {26: 1}, False),
        (0.02, THUMB_AND_INDEX | {40: 1}, False),
        (0.02, THUMB_AND_INDEX | {16: 50, 20: 50, 25: 1}, True),  # head, left elbow and eye are no left hand
        (0.02, {26: 50, 38: 50}, False),
        (0.02, {}, False),
    ],
)
def test_frames_of_the_papers_rules(height, parts, expected):
    assert kept(paper(), sequence([(height, parts)])) == ([1] if expected else [])


@pytest.mark.parametrize(
    ("change", "height", "parts"),
    [
        ({"min_lift": 0.0}, 0.0, THUMB_AND_INDEX),
        ({"left_hand_free": False}, 0.02, THUMB_AND_INDEX | {30: 9}),
        ({"thumb": False}, 0.02, {41: 50}),
        ({"min_other_fingers": 0}, 0.02, {53: 50}),
        ({"min_finger_vertices": 10}, 0.02, {53: 10, 44: 10}),
        ({"right_hand": False, "thumb": False, "min_other_fingers": 0}, 0.02, {}),
    ],
)
def test_every_rule_can_be_changed(change, height, parts):
    frames = sequence([(height, parts)])
    assert 1 not in kept(paper(), frames)
    assert 1 in kept(paper(**change), frames)


def test_every_nth_frame():
    frames = sequence([(0.02, THUMB_AND_INDEX)] * 9)
    assert kept(paper(every=4), frames) == [4, 8]


def test_the_waterfall_counts_what_each_rule_leaves():
    grasp, palm, both = (0.02, THUMB_AND_INDEX), (0.02, {22: 80}), (0.02, THUMB_AND_INDEX | {21: 3})
    first = sequence([grasp, grasp, palm, both, (0.0, THUMB_AND_INDEX)])
    second = sequence([grasp])
    waterfall, rules = Waterfall(), paper()
    waterfall.add("test", "pass", "mug", frames_left(rules.passed(first)))
    waterfall.add("test", "pass", "mug", frames_left(rules.passed(first)))
    waterfall.add("val", "lift", "apple", frames_left(rules.passed(second)))
    left = {"in all": 12, "every": 12, "right_hand": 10, "left_hand_free": 8, "min_lift": 6, "thumb": 4}
    assert waterfall.by("object")[("mug",)] == left | {"min_other_fingers": 4}
    assert waterfall.by("split", "intent").keys() == {("test", "pass"), ("val", "lift")}
    assert waterfall.by()[()]["in all"] == 14
    assert waterfall.by()[()]["min_other_fingers"] == 2 * len(kept(rules, first)) + len(kept(rules, second))


def test_frames_in_the_store_show_the_scene_that_was_recorded(tmp_path):
    """Hand and object, rebuilt from the store, lie to each other as in the file, up to the shift to the centroid."""
    made, hand = random_sequence(6), HandModel.open()
    solid = trimesh.creation.box((0.03, 0.05, 0.08))
    solid.apply_translation((0.1, -0.2, 0.05))
    centroid = solid.vertices.mean(0)
    frames = np.array([1, 4, 5])
    write_frames(tmp_path, made.name, GraspTrack.right(made).frames(frames), torch.tensor(centroid).float())
    finish_store(tmp_path, hand.fingerprint, {made.sbj_id: hand.v_template}, [made.obj_name], {})
    stored = FramesStore.load(tmp_path).frames
    assert stored.frame.tolist() == [1, 4, 5]

    rotations = Rotation.from_rotvec(made.object.global_orient[frames]).as_matrix()
    world = solid.vertices @ rotations + made.object.transl[frames, None]  # row vectors
    centre = world.mean(1, keepdims=True)
    turned = Rotation.from_rotvec(stored.object_orient.numpy()).as_matrix()
    np.testing.assert_allclose(np.einsum("nij,vj->nvi", turned, solid.vertices - centroid), world - centre, atol=1e-6)
    recorded = hand(made.rhand.parameters(frames)).vertices
    np.testing.assert_allclose(hand(stored.hand()).vertices, recorded - torch.tensor(centre), atol=1e-5)
