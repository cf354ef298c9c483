"""What is evaluated on follows from the split, whatever it is by."""

from __future__ import annotations

import numpy as np
from hydra.utils import instantiate

from grabnet.cli.entry import compose
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.methods import make_methods


def test_held_out_people_are_compared_with_their_own_grasps(tiny_dataset, cache_dir):
    values = [
        "data=frames",
        f"data.root={tiny_dataset}",
        "data.split.by=subject",
        "data.split.val=[]",
        "data.split.test=[s2]",
        f"cache_dir={cache_dir}",
        f"data.cache_dir={cache_dir}",
        "models=[]",
        "optimise=0",
        "candidates=1",
    ]
    inputs = EvaluationInputs(instantiate(compose("evaluate", values), _convert_="object"))
    store = inputs.store
    assert inputs.objects == store.objects
    for name, hands in inputs.truth.items():
        assert {store.sequences[number] for number in np.unique(hands.sequences)} == {f"s2/{name}_lift_1"}
    assert inputs.training_part.frames.subject.unique().tolist() == [store.subjects.index("s1")]
    assert len(inputs.training_keypoints) == len(store.frames) / 2
    # The naive baseline takes grasps of the same objects by the others.
    assert [method.name for method in make_methods(inputs)] == ["Ground truth", "Naive baseline"]
