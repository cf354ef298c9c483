"""How far two annotations of the same frames agree."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np

from grabnet.body.skeleton import N_PARTS


def agreeing(one: np.ndarray, other: np.ndarray) -> Counter[str]:
    """Compare labels (T, V) of an object's vertices with others; counts of several recordings can be added.

    Returns:
        "frames" in which either has contact, and "frame_overlap", the sum over them of the parts that both have to
        those that either has; of pairs of a frame and a part, and of a frame and a vertex, how many touch in "…_one",
        in "…_other" and in "…_both".
    """
    parts = [np.stack([(labels == part).any(1) for part in range(1, N_PARTS + 1)], 1) for labels in (one, other)]
    vertices = [labels > 0 for labels in (one, other)]
    both, either = (np.logical_and(*parts).sum(1), np.logical_or(*parts).sum(1))
    counts: Counter[str] = Counter()
    counts["frames"] = int((either > 0).sum())
    counts["frame_overlap"] = float((both[either > 0] / either[either > 0]).sum())
    for name, (a, b) in (("parts", parts), ("vertices", vertices)):
        counts[f"{name}_one"], counts[f"{name}_other"] = int(a.sum()), int(b.sum())
        counts[f"{name}_both"] = int((a & b).sum())
    return counts


def shares(counts: Mapping[str, float]) -> dict[str, float]:
    """From counts of `agreeing` to what both share; 1 where neither has contact.

    Returns:
        "part_agreement", mean over frames of the parts that both have to those that either has; "part_f1" and
        "vertex_f1", twice what touches in both to what touches in each, by part and frame and by vertex and frame.
    """
    found = {"part_agreement": counts["frame_overlap"] / counts["frames"] if counts["frames"] else 1.0}
    for name, key in (("parts", "part_f1"), ("vertices", "vertex_f1")):
        each = counts[f"{name}_one"] + counts[f"{name}_other"]
        found[key] = 2 * counts[f"{name}_both"] / each if each else 1.0
    return found
