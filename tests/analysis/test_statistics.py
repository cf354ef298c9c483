"""Every statistic against counting by hand; all sums are the same in whatever order sequences come."""

from __future__ import annotations

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from grabnet.analysis.comparing import compared, difference
from grabnet.analysis.frames import ALL, FINGER_PARTS, SURFACES, WHO, Group, Solid, Subset
from grabnet.analysis.registry import STATISTICS
from grabnet.analysis.statistic import Analysed
from grabnet.analysis.statistics.body_heat import BodyHeat
from grabnet.analysis.statistics.clusters import Clusters
from grabnet.analysis.statistics.content import Content
from grabnet.analysis.statistics.object_heat import ObjectHeat
from grabnet.analysis.statistics.penetration import Penetration
from grabnet.analysis.statistics.shares import ContactShares
from grabnet.analysis.statistics.sizes import SizeEffect, SizeHeat
from grabnet.analysis.statistics.threshold_heat import ThresholdHeat, setups
from grabnet.analysis.statistics.thresholds import Thresholds
from grabnet.geometry.mesh import Mesh
from tests.analysis.toy import BOX, GROUPS, RULES, box, has, is_contact, sequence

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
    assert counted(SizeEffect, [replace(SEQUENCES[0], group=Group("use", "s1", "mug"))]).result(ALL) == []
    found = row(rows, subjects="smallest hand (s1, 180 mm)", shape="cube", size="small")
    there = contact([SEQUENCES[0], SEQUENCES[2]])
    assert found["contact frames"] == len(there)
    assert found["left hand [%]"] == pytest.approx(100 * np.mean([has(f, t, WHO["left hand"]) for f, t in there]))


def test_size_heat():
    heat = counted(SizeHeat)
    there = contact([SEQUENCES[0], SEQUENCES[2]])
    for of_what, labels in (("object", "object"), ("body", "body")):
        share = np.mean([getattr(f, labels)[t] > 0 for f, t in there], 0)
        np.testing.assert_allclose(heat.share(Subset(objects=["cubesmall"]), of_what), share)
    found = row(heat.result(ALL), subjects="smallest hand (s1, 180 mm)", shape="cube", size="small")
    assert found["contact frames"] == len(there)
    touched = {v for f, t in there for v in np.flatnonzero(f.body[t])}
    assert found["body, ever touched [%]"] == pytest.approx(100 * len(touched) / 60)


def test_threshold_heat():
    """Vertex by vertex: it counts where its finger, or the part that it is of, touches C vertices of the object."""
    fingers = [set(range(26 + 3 * k, 29 + 3 * k)) for k in range(10)]
    heat, pairs = counted(ThresholdHeat), setups(RULES)
    assert pairs == [(0.005, 1), (0.0, 1), (0.02, 1), (0.005, 2), (0.005, 4)]
    shares = []
    for (lift, least), found in zip(pairs, heat.shares(Subset(["use"])), strict=True):
        there = [(f, t) for f in of("use") for t in range(len(f)) if is_contact(f, t, lift)]
        counts = np.zeros(60)
        for f, t in there:
            for v, part in enumerate(f.body[t]):
                together = next((finger for finger in fingers if part in finger), {part})
                counts[v] += part > 0 and has(f, t, together, least)
        shares.append(counts / len(there))
        np.testing.assert_allclose(found, shares[-1])
    found = row(heat.result(ALL), intent="use", C="4", **{"H [mm]": "5"})
    change = 100 * np.abs(shares[-1] - shares[0])
    assert found["largest change [points]"] == pytest.approx(change.max()) and change.max() > 5
    touched = (shares[-1] > 0) | (shares[0] > 0)
    assert found["mean change [points]"] == pytest.approx(change[touched].mean())


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


@pytest.mark.parametrize("surface", ["hands", "head"])
def test_penetration(surface):
    """The depth within a box is the distance to its nearest side."""
    values = []
    for frames in of("use"):
        there = [t for t in range(len(frames)) if is_contact(frames, t) and has(frames, t, SURFACES[surface])]
        for t in there[:: RULES.posed_every]:
            points = np.concatenate([posed(np.array([t]))[0].numpy() for posed in frames.surfaces[surface]])
            depths = [d for d in (BOX / 2 - np.abs(points)).min(1) if d > 0]
            if depths:
                values.append([max(depths), np.mean(depths), np.median(depths)])
    rows = counted(Penetration).result(ALL)
    for kind, column in zip(("max", "mean", "median"), np.transpose(values), strict=True):
        found = row(rows, intent="use", surface=surface, **{"of a frame": kind})
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
    hands = hands.astype(np.float16).astype(np.float32)  # as they are kept
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


def test_grasps_that_are_alike_are_one_cluster():
    clusters, hand = Clusters(RULES), np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    noise = np.random.default_rng(1).normal(0, 0.0002, (9, 20, 3))
    clusters._keep(Group("use", "s1", "mug"), np.arange(9, dtype=np.uint64), hand + noise)
    assert [cluster.grasps for cluster in clusters.clusters(ALL, "mug")] == [9]


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
    if subset.by.keys() <= set(kind.by):
        assert counted(kind).result(subset) == []
    else:  # merged: numbers of everyone would be taken for those of the subset
        with pytest.raises(ValueError, match=r"does not tell (intent|subject|object) apart"):
            counted(kind).result(subset)


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
    assert list(SEQUENCES[0].depths("hands", np.zeros(0, int))) == []


def test_points_on_all_sides_of_a_solid():
    points = torch.tensor(np.random.default_rng(0).uniform(-0.08, 0.08, (500, 3)), dtype=torch.float32)
    expected = (BOX / 2 - np.abs(points.numpy())).min(1).clip(0)
    np.testing.assert_allclose(Solid(box()).depths(points), expected, atol=1e-6)
    assert (expected > 0).sum() > 50


@pytest.mark.parametrize("kind", STATISTICS)
def test_what_is_not_told_apart_can_be_merged(kind):
    """As a pass adds up: the results are those of the groups as they are."""
    merged = kind(RULES)
    for frames in SEQUENCES:
        one = kind(RULES)
        one.add(frames)
        one.sums = {(group.merged(kind.by), what): value for (group, what), value in one.sums.items()}
        merged.merge(one)
    assert str(merged.result(ALL)) == str(counted(kind).result(ALL))
    assert len(merged.groups(ALL)) == len({tuple(getattr(g, by) for by in kind.by) for g in counted(kind).groups(ALL)})


@pytest.mark.parametrize("same_faces", [True, False])
def test_differences_are_shown_on_the_mesh_that_they_are_of(same_faces):
    """Two data sets, whose "cubesmall" has other vertices, or as many with other faces."""

    def data(label: str, n: int, last: int):
        mesh = Mesh(np.eye(3)[np.arange(n) % 3], np.array([[0, 1, 2], [0, 1, last]]))
        return SimpleNamespace(label=label, object_mesh=lambda name: mesh)

    def fewer(frames):
        return frames if not same_faces else replace(frames, object=frames.object[:, :20])

    sets = [SEQUENCES[0], SEQUENCES[2]]
    ours = Analysed(data("a", 30, 3), {ObjectHeat.name: counted(ObjectHeat, sets)})
    theirs = Analysed(
        data("b", 20 if same_faces else 30, 3 if same_faces else 4),
        {ObjectHeat.name: counted(ObjectHeat, [fewer(frames) for frames in sets])},
    )
    found = ObjectHeat.heats([ours, theirs])
    assert {name: list(heats.changes) for name, heats in found.items()} == {
        "cubesmall": ["a, use − pass"], "cubesmall of b": ["b, use − pass"],
    }  # fmt: skip
    for heats in found.values():
        assert {len(v) for v in (*heats.shares.values(), *heats.changes.values())} == {len(heats.vertices)}
    use, other = (np.mean([f.object[t] > 0 for f, t in contact([fewer(s)])], 0) for s in sets)
    np.testing.assert_allclose(found["cubesmall of b"].changes["b, use − pass"], use - other)


def test_all_generated_grasps_are_posed():
    """They have no lift, and no order that every n-th could be of."""
    grasps = replace(SEQUENCES[0], lift=np.full(len(SEQUENCES[0]), np.inf))
    there = [t for t in range(len(grasps)) if is_contact(grasps, t) and has(grasps, t, SURFACES["hands"])]
    found = row(counted(Penetration, [grasps]).result(ALL), intent="use", surface="hands", **{"of a frame": "max"})
    assert found["posed frames"] == len(there) > 20


def test_the_curve_over_c_is_at_the_lift_of_contact_frames():
    thresholds = Thresholds(replace(RULES, min_lift=0.02))
    for frames in SEQUENCES:
        thresholds.add(frames)
    figure = Thresholds.draw([Analysed(SimpleNamespace(label="a"), {Thresholds.name: thresholds})])
    assert "(H = 20)" in figure.axes[1].get_xlabel()
