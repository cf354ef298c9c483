"""The open data as a source of frames."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.body.anatomy import Anatomy
from grabnet.open import dataset
from grabnet.open.dataset import OpenData
from grabnet.open.grasps.store import load_open_grasps


def test_every_grasp_is_in_one_sequence(tmp_path):
    source, grasps = OpenData(str(tmp_path), 0.26, 0), load_open_grasps()
    sequences = source.sequences()
    assert len(set(sequences)) == len(sequences)
    assert sum(len(source.read(sequence).frame) for sequence in sequences) == len(grasps)


def test_hand_and_object_lean_together_and_none_that_stands(tmp_path):
    """In the object's frame the hand is where it was synthesised."""
    source, grasps = OpenData(str(tmp_path), 0.26, 0), load_open_grasps()
    frames = source.read("s3/mug_grasp_1")
    index = (grasps.object == grasps.objects.index("mug")) & (grasps.subject == grasps.subjects.index("s3"))
    rest = source.hand.shaped(grasps.betas)[grasps.subjects.index("s3")]
    expected = source.hand(grasps.parameters(Anatomy.of(source.hand), index), rest).vertices
    found = source.hand(frames.hand, source.subjects()["s3"]).vertices - frames.object_transl[:, None]
    torch.testing.assert_close(found @ frames.object_rotation, expected, atol=1e-5, rtol=0)
    upright = frames.object_rotation[:, 2, 2]
    stands = grasps.clears_table[index]
    assert torch.allclose(upright[stands], torch.ones(())) and (upright[~stands] < 0.9999).all()
    headings = torch.atan2(frames.object_rotation[:, 1, 0], frames.object_rotation[:, 0, 0])
    assert np.unique(headings.numpy()).size == len(headings)


def test_the_recipe_holds_every_setting_and_both_formats(tmp_path, monkeypatch):
    def recipe(tilt=0.26, seed=0):
        return OpenData(str(tmp_path), tilt, seed).recipe()

    assert recipe() == recipe()
    others = [recipe(tilt=0.1), recipe(seed=1)]
    for name in ("FORMAT", "OBJECTS_FORMAT"):
        with monkeypatch.context() as patch:
            patch.setattr(dataset, name, 99)
            others.append(recipe())
    assert all(other != recipe() for other in others)
