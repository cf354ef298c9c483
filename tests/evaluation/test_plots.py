"""Plots take names as they are."""

from __future__ import annotations

import numpy as np
import pytest

from grabnet.evaluation.bootstrap import Estimate
from grabnet.evaluation.methods import Method
from grabnet.evaluation.metrics import ALL, FURTHER, Metric
from grabnet.evaluation.reporting.plots import distributions, intervals
from grabnet.evaluation.summary import Figure


@pytest.mark.parametrize("name", [r"my $\frac$ grasps", "$_{$", "5$ or 6$", "100 %"])
def test_a_name_that_looks_like_a_formula_is_a_name(name):
    metric = Metric("contact", "ratio", "%", "share", section=FURTHER)
    method = Method(name, "", None, {}, results={name: {metric.title: np.array([0.1, 0.2])}})
    drawn = intervals([Figure(metric, name, ALL, Estimate(1.0, np.array([0.5, 1.5]), 2))], [method], [metric])
    assert drawn.startswith("<?xml") or "<svg" in drawn
    assert "<svg" in distributions([method], [metric], [name])
