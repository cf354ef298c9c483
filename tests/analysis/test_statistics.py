"""Every statistic against counting by hand; all sums are the same in whatever order sequences come."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch

from grabnet.analysis.comparing import compared, difference
from grabnet.analysis.frames import FINGER_PARTS, WHO, Group, Subset
from grabnet.analysis.registry import STATISTICS
from grabnet.analysis.statistics.body_heat import BodyHeat
from grabnet.analysis.statistics.clusters import Clusters
from grabnet.analysis.statistics.content import Content
from grabnet.analysis.statistics.object_heat import ObjectHeat
from grabnet.analysis.statistics.penetration import Penetration
from grabnet.analysis.statistics.shares import ContactShares, SizeEffect
from grabnet.analysis.statistics.thresholds import Thresholds
from tests.analysis.toy import BOX, GROUPS, RULES, has, is_contact, sequence

ALL = Subset()
SEQUENCES = [sequence(k) for k in range(len(GROUPS))]


def counted(kind, sequences=SEQUENCES):
    """Each sequence by itself, then added up, as workers do."""
    whole = kind(RULES)
    for frames in sequences:
        one = kind(RULES)
        one.add(frames)
        whole.merge(one)
    return whole


def of(intent: str):
    return [frames for frames in SEQUENCES if intent in ("all", frames.group.intent)]


def contact(sequences):
    return [(frames, t) for frames in sequences for t in range(len(frames)) if is_contact(frames, t)]


def row(rows, **chosen):
    (found,) = [row for row in rows if chosen.items() <= row.items()]
    return found


def test_content():
    rows = counted(Content).result(ALL)
    expected = {"sequences": 2, "frames": 80, "contact frames": len(contact(of("use")))}
    assert row(rows, by="intent", name="use") == {"by": "intent", "name": "use"} | expected
    assert row(rows, by="all", name="all")["contact frames"] == len(contact(SEQUENCES))
    assert row(rows, by="object", name="cubesmall")["sequences"] == 2
    chosen = counted(Content).result(Subset(subjects=["s2"], intents=["use", "lift"]))
    assert {r["name"] for r in chosen if r["by"] == "object"} == {"cubelarge", "spheresmall"}


@pytest.mark.parametrize("intent", ["all", "use", "pass", "lift"])
def test_shares(intent):
    found, there = row(counted(ContactShares).result(ALL), intent=intent), contact(of(intent))
    right = [(f, t) for f, t in there if has(f, t, WHO["right hand"])]
    both = [1 for f, t in right if has(f, t, WHO["left hand"])]
    assert found["contact frames"] == len(there) > 10
    assert found["both hands [%]"] == pytest.approx(100 * len(both) / len(there))
    for who, parts in WHO.items():
        assert found[f"{who} [%]"] == pytest.approx(100 * np.mean([has(f, t, parts) for f, t in there]))
    for part, labels in FINGER_PARTS.items():
        assert found[f"{part} [%]"] == pytest.approx(100 * np.mean([has(f, t, labels) for f, t in right]))


def test_sizes():
    rows = counted(SizeEffect).result(ALL)
    assert [r["subjects"] for r in rows if r["size"] == "large"] == ["all", "biggest hand (s2, 190 mm)"]
    found = row(rows, subjects="smallest hand (s1, 180 mm)", shape="cube", size="small")
    there = contact([SEQUENCES[0], SEQUENCES[2]])
    assert found["contact frames"] == len(there)
    assert found["left hand [%]"] == pytest.approx(100 * np.mean([has(f, t, WHO["left hand"]) for f, t in there]))


def test_thresholds():
    rows = counted(Thresholds).result(ALL)
    for (h, lift), c in itertools.product(enumerate(RULES.lifts), RULES.finger_vertices):
        found = row(rows, intent="use", C=str(c), **{"H [mm]": f"{1000 * lift:g}"})
        there = [(f, t) for f in of("use") for t in range(len(f)) if is_contact(f, t, lift)]
        right = [(f, t) for f, t in there if has(f, t, WHO["right hand"], c)]
        assert found["contact frames"] == len(there) > 5 * (3 - h)
        assert found["head [%]"] == pytest.approx(100 * np.mean([has(f, t, WHO["head"], c) for f, t in there]))
        if right:
            ring = 100 * np.mean([has(f, t, FINGER_PARTS["ring"], c) for f, t in right])
            assert found["ring [%]"] == pytest.approx(ring)
    base = row(counted(ContactShares).result(ALL), intent="use")
    same = row(rows, intent="use", C="1", **{"H [mm]": "5"})
    assert {k: base[k] for k in same if k in base} == {k: same[k] for k in same if k in base}


@pytest.mark.parametrize("intent", ["all", "use", "pass"])
def test_body_heat(intent):
    heat, there = counted(BodyHeat), contact(of(intent))
    chosen = ALL if intent == "all" else Subset([intent])
    share = np.mean([[label > 0 for label in f.body[t]] for f, t in there], 0)
    np.testing.assert_allclose(heat.share(chosen), share)
    right = [(f, t) for f, t in there if has(f, t, WHO["right hand"])]
    np.testing.assert_allclose(heat.share(chosen, "right hand") * len(right), share * len(there))
    found = row(heat.result(ALL), intent=intent)
    assert found["highest likelihood [%]"] == pytest.approx(100 * share.max())


def test_object_heat():
    heat = counted(ObjectHeat)
    there = contact([SEQUENCES[0], SEQUENCES[2]])
    share = np.mean([[label > 0 for label in f.object[t]] for f, t in there], 0)
    np.testing.assert_allclose(heat.share(ALL, "cubesmall"), share)
    use = contact([SEQUENCES[0]])
    np.testing.assert_allclose(heat.share(Subset(["use"]), "cubesmall"), np.mean([f.object[t] > 0 for f, t in use], 0))
    assert heat.share(Subset(["lift"]), "cubesmall") is None


def test_penetration():
    """The depth within a box is the distance to its nearest side."""
    values = []
    for frames in of("use"):
        for t in [t for t in range(len(frames)) if is_contact(frames, t)][:: RULES.posed_every]:
            points = np.concatenate([hand(np.array([t]))[0].numpy() for hand in frames.hands])
            depths = [d for d in (BOX / 2 - np.abs(points)).min(1) if d > 0]
            if depths:
                values.append([max(depths), np.mean(depths), np.median(depths)])
    rows = counted(Penetration).result(ALL)
    for kind, column in zip(("max", "mean", "median"), np.transpose(values), strict=True):
        found = row(rows, intent="use", **{"of a frame": kind})
        assert found["frames inside"] == len(values) > 8
        assert found["mean [mm]"] == pytest.approx(1000 * column.mean(), rel=1e-4)
        assert found["deviation [mm]"] == pytest.approx(1000 * column.std(), rel=1e-3)
        assert found["≤ 5.8 mm [%]"] == pytest.approx(100 * np.mean(column <= 0.0058))


def test_clusters():
    """Three heaps of hands, far apart, are three clusters; their centres are hands; markers near one are found."""
    rng = np.random.default_rng(0)
    centres = np.array([[0.2, 0, 0], [0, 0.3, 0], [0, 0, 0.5]])
    sizes = [6, 4, 2]
    hands = np.concatenate([
        c + rng.normal(0, 0.001, (n, 20, 3)) for c, n in zip(centres, sizes, strict=True)
    ]).astype(np.float32)  # fmt: skip
    clusters = Clusters(RULES)
    group = Group("use", "s1", "mug")
    order = rng.permutation(len(hands))
    clusters._keep(group, order.astype(np.uint64), hands)
    clusters.markers = {"mug": hands[7, :1].astype(float) + np.array([0, 0, 0.001])}
    found = clusters.clusters(ALL, "mug")
    assert [cluster.grasps for cluster in found] == sizes
    for cluster, centre in zip(found, centres, strict=True):
        assert np.linalg.norm(cluster.hand.mean(0) - centre) < 0.002
        assert (np.abs(hands - cluster.hand).max((1, 2)) == 0).any()
    assert [cluster.markers for cluster in found] == [0, 1, 0]
    assert clusters.result(ALL)[0] == {
        "object": "mug", "grasps": 12, "clusters": 3, "largest cluster [%]": 50.0, "markers": 1,
        "clusters touching markers": 1,
    }  # fmt: skip


@pytest.mark.parametrize("kind", STATISTICS)
def test_the_order_of_sequences_does_not_matter(kind):
    more = [*SEQUENCES, *(replace(sequence(k, n=30), name=f"take 2 of {k}") for k in range(len(GROUPS)))]
    one, other = counted(kind, more), counted(kind, more[::-1])
    assert one.sums.keys() == other.sums.keys()
    for key, value in one.sums.items():
        np.testing.assert_allclose(value, other.sums[key])


def test_grasps_to_cluster_are_bounded():
    more = [replace(sequence(0, n), name=str(n)) for n in (40, 60, 80)]
    assert len(counted(Clusters, more).sums[GROUPS[0], "ranks"]) == RULES.grasps_per_object


@pytest.mark.parametrize("kind", STATISTICS)
@pytest.mark.parametrize("subset", [Subset(["offhand"]), Subset(objects=[]), Subset(subjects=["s9"])])
def test_an_empty_subset_has_no_lines(kind, subset):
    assert counted(kind).result(subset) == []


@pytest.mark.parametrize("kind", STATISTICS)
def test_a_sequence_without_contact_counts_and_shows_nothing(kind):
    rows = counted(kind, [sequence(0, touching=False)]).result(ALL)
    numbers = [v for r in rows for k, v in r.items() if "%" in k or "mm]" in k if not isinstance(v, str)]
    assert all(np.isnan(number) or number == 0 for number in numbers)


def test_what_is_compared():
    items = [("a", "all"), ("a", "use"), ("a", "pass"), ("b", "all"), ("b", "use"), ("b", "lift")]
    assert compared(items, lambda item: item) == [
        (("a", "use"), ("a", "pass")), (("b", "use"), ("b", "lift")), (("a", "all"), ("b", "all")),
    ]  # fmt: skip
    ours = [{"intent": "use", "x": 3.0, "markers": None}, {"intent": "lift", "x": 1.0, "markers": 2}]
    theirs = [{"intent": "use", "x": 1.0, "markers": 2}]
    assert difference(ours, theirs) == [{"intent": "use", "x": 2.0, "markers": None}]


def test_depths_of_no_frames():
    assert SEQUENCES[0].depths(np.zeros(0, int)).shape[0] == 0
    assert isinstance(SEQUENCES[0].hands[0](np.array([0])), torch.Tensor)
