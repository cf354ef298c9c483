"""Recordings in GRAB's format, of random numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from grabnet.data.sequences import BodyTrack, ContactTrack, HandTrack, RigidTrack, Sequence


def random_sequence(n_frames: int = 7, n_object: int = 40, seed: int = 0, **changes: Any) -> Sequence:
    """A sequence that holds every field in its right shape; `changes` replaces fields."""
    rng = np.random.default_rng(seed)

    def track(*widths: int) -> list[np.ndarray]:
        return [rng.normal(0, 0.4, (n_frames, width)).astype(np.float32) for width in widths]

    fields = {
        "name": "s1/mug_pass_1", "gender": "female", "sbj_id": "s1", "obj_name": "mug", "motion_intent": "pass",
        "framerate": 120.0, "n_comps": 24,
        "body": BodyTrack(*track(3, 3, 63, 3, 3, 3, 24, 24, 165, 10), "tools/subject_meshes/female/s1.ply"),
        "rhand": HandTrack(*track(3, 24, 3, 45), "tools/subject_meshes/female/s1_rhand.ply"),
        "lhand": HandTrack(*track(3, 24, 3, 45), "tools/subject_meshes/female/s1_lhand.ply"),
        "object": RigidTrack(*track(3, 3), "tools/object_meshes/contact_meshes/mug.ply"),
        "table": RigidTrack(*track(3, 3), "tools/object_meshes/contact_meshes/table.ply"),
        "contact": ContactTrack(
            rng.integers(0, 56, (n_frames, n_object)).astype(np.uint8),
            rng.integers(0, 56, (n_frames, 100)).astype(np.uint8),
        ),
    }  # fmt: skip
    return Sequence(**(fields | changes))
