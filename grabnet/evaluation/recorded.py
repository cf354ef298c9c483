"""Recorded grasps: those that others are compared with, and those that stand beside others as a method."""

from __future__ import annotations

import numpy as np
import torch

from grabnet.body.hand import HandModel
from grabnet.data.frames import FramesStore
from grabnet.evaluation.hands import Hands
from grabnet.geometry.mesh import Mesh
from grabnet.geometry.rotations import axis_angle_to_matrix

# Hands posed at once.
_BATCH = 256


@torch.no_grad()
def recorded_hands(store: FramesStore, hand: HandModel, name: str, mesh: Mesh, most: int | None = None) -> Hands:
    """Return the recorded grasps of one object, each in its subject's shape, in the frame of the object's mesh.

    Args:
        store: of the frames.
        hand: the model that the store was made with.
        name: of the object.
        mesh: of the object.
        most: so many of them, evenly spaced, where there are more.
    """
    index = (store.frames.object == store.objects.index(name)).nonzero().squeeze(1)
    if most is not None and most < len(index):
        index = index[torch.linspace(0, len(index) - 1, most).long()]
    vertices, poses = [], []
    for part in index.split(_BATCH):
        frames = store.frames.select(part)
        parameters = frames.hand()
        posed = hand(parameters, store.v_template[frames.subject]).vertices
        vertices.append(posed @ axis_angle_to_matrix(frames.object_orient) + torch.as_tensor(mesh.centroid))
        poses.append(parameters.hand_pose)
    return Hands(
        vertices=torch.cat(vertices).numpy(),
        faces=hand.faces.numpy(),
        hand_pose=torch.cat(poses).numpy(),
        sequences=store.frames.sequence[index].numpy(),
    )


def held_out(truth: Hands) -> np.ndarray:
    """Return (M,) bool: every other recording.

    The method "Ground truth" is drawn from the rest, so that the two never share a recording, whose frames may hardly
    differ.
    """
    recordings = np.unique(truth.sequences)
    return np.isin(truth.sequences, recordings[1::2])


def ground_truth_sample(truth: Hands, n: int, seed: int) -> Hands:
    """Return up to n recorded grasps at random, none of them held out."""
    candidates = (~held_out(truth)).nonzero()[0]
    return truth.select(np.random.default_rng([seed, 2]).permutation(candidates)[:n])


def same_sequence(hands: Hands, truth: Hands) -> np.ndarray:
    """Return (N, M) bool: which of the recorded grasps are of the same recording as each hand."""
    if hands.sequences is None:
        return np.zeros((len(hands), len(truth)), bool)
    return hands.sequences[:, None] == truth.sequences
