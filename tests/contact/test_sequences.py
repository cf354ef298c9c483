"""Contact of recordings: the body posed, brought into the object's frame, and labelled by joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from grabnet.body.hand import HandModel
from grabnet.body.whole import BodyModel
from grabnet.contact.sequences import annotate
from grabnet.geometry.mesh import Mesh
from grabnet.preprocess.statistics import agreement, overlap
from tests.body.conftest import BODY_PARENTS
from tests.data.grab import random_sequence

WRIST, FIRST_FINGER = 21, 40  # joints of the right hand in SMPL-X


@pytest.fixture(scope="module")
def body(tmp_path_factory) -> BodyModel:
    """A body that has nothing but a right hand, which hangs on the joints that SMPL-X's right hand hangs on."""
    hand = HandModel.open()
    joints = [WRIST, *range(FIRST_FINGER, FIRST_FINGER + 15)]
    regressor, weights = np.tile(hand.J_regressor[0].numpy(), (55, 1)), np.zeros((778, 55), np.float32)
    regressor[joints], weights[:, joints] = hand.J_regressor.numpy(), hand.weights.numpy()
    path = tmp_path_factory.mktemp("body") / "SMPLX_NEUTRAL.npz"
    np.savez(
        path, v_template=hand.v_template, shapedirs=np.zeros((778, 3, 20)), posedirs=np.zeros((778, 3, 486)),
        J_regressor=regressor, weights=weights, kintree_table=np.array([BODY_PARENTS, range(55)]), f=hand.faces,
        hands_componentsl=np.eye(45), hands_componentsr=np.eye(45), hands_meanl=np.zeros(45), hands_meanr=np.zeros(45),
    )  # fmt: skip
    return BodyModel(path)


def test_a_recording_is_labelled_by_the_parts_that_touch(body):
    """A ball is held 2 mm from one fingertip after the other, while hand and ball move and turn through the room."""
    hand, ball = HandModel.open(), trimesh.creation.icosphere(4, 0.008)
    made, rng = random_sequence(5), np.random.default_rng(0)
    fullpose = np.zeros((5, 165), np.float32)
    wrists = Rotation.random(5, rng)
    fullpose[:, 3 * WRIST : 3 * WRIST + 3] = wrists.as_rotvec()
    transl = rng.normal(0, 0.5, (5, 3)).astype(np.float32)
    wrist = hand.rest_joints(hand.v_template)[0].numpy()

    def in_room(points):  # of the resting hand, frame by frame
        return np.stack([r.apply(p - wrist) + wrist + t for r, p, t in zip(wrists, points, transl, strict=True)])

    distal = [hand.weights[:, joint].numpy() > 0.99 for joint in (3, 6, 9, 12, 15)]
    rest = hand.v_template.numpy()
    tips = np.array([rest[part][np.linalg.norm(rest[part] - wrist, axis=1).argmax()] for part in distal])
    outwards = (tips - wrist) / np.linalg.norm(tips - wrist, axis=1, keepdims=True)
    centres = in_room(tips + 0.01 * outwards)
    turns = Rotation.random(5, rng)
    recorded = replace(
        made,
        body=replace(made.body, fullpose=fullpose, transl=transl, expression=np.zeros((5, 10), np.float32)),
        object=replace(made.object, transl=centres.astype(np.float32),
                       global_orient=turns.as_rotvec().astype(np.float32)),
    )  # fmt: skip
    contact = annotate(recorded, body, body.v_template, Mesh(ball.vertices, ball.faces)).labels
    assert contact.object.shape == (5, len(ball.vertices)) and contact.body.shape == (5, 778)
    for k in range(5):
        part = FIRST_FINGER + 1 + 3 * k + 2
        assert set(np.unique(contact.body[k])) == {0, part}
        assert set(np.unique(contact.object[k])) == {0, part}
        # The touched side of the ball, as rows turned by its rotation, points back at the fingertip.
        towards = ball.vertices[contact.object[k] > 0].mean(0) @ turns[k].as_matrix()
        tip = in_room(np.tile(tips[k], (5, 1)))[k]
        assert towards @ (tip - centres[k]) > 0.95 * np.linalg.norm(towards) * np.linalg.norm(tip - centres[k])


def test_agreement_is_intersection_over_union_of_each_part():
    one = np.array([[41, 41, 41, 0], [55, 0, 0, 0]])
    other = np.array([[41, 41, 0, 41], [0, 0, 0, 22]])
    assert agreement([overlap(one, other)]) == {22: 0.0, 41: 0.5, 55: 0.0}
    assert agreement([overlap(one, one)]) == {41: 1.0, 55: 1.0}
    assert agreement([overlap(one, one), overlap(one, other)]) == {22: 0.0, 41: 5 / 7, 55: 0.5}
    assert agreement([overlap(one * 0, one * 0)]) == {}
