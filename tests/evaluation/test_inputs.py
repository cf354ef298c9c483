"""What is evaluated on follows from the split, whatever it is by."""

from __future__ import annotations

import numpy as np
from hydra.utils import instantiate

from grabnet.cli.entry import compose
from grabnet.evaluation.inputs import Material


def test_held_out_people_are_compared_with_their_own_grasps(tiny_dataset, cache_dir):
    values = [
        "data=frames",
        f"data.root={tiny_dataset}",
        "data.split.by=subject",
        "data.split.val=[]",
        "data.split.test=[s2]",
        f"cache_dir={cache_dir}",
        f"data.cache_dir={cache_dir}",
    ]
    material = Material(instantiate(compose("evaluate", values), _convert_="object"))
    store = material.store
    assert material.objects == store.objects
    for name, hands in material.truth.items():
        assert {store.sequences[number] for number in np.unique(hands.sequences)} == {f"s2/{name}_lift_1"}
    assert material.training_part.frames.subject.unique().tolist() == [store.subjects.index("s1")]
    assert len(material.training_keypoints) == len(store.frames) / 2
