"""A protocol of each kind, in this file and a line of the registry each, is in every output."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from hydra.utils import instantiate

from grabnet.cli.entry import compose
from grabnet.evaluation import registry
from grabnet.evaluation.bootstrap import mean
from grabnet.evaluation.metrics import ALL, Metric, Section
from grabnet.evaluation.protocol import PerGrasp, PerMethod, PerNetwork, PerObject, Score
from grabnet.evaluation.run import run
from grabnet.models.weights import save_network

REPORTING = Path(registry.__file__).parent / "reporting"


class Height(PerGrasp):
    """How high above the object's centroid a hand's lowest vertex is, cm."""

    name = "height"
    metrics = (
        Metric(
            *("height", "lowest", "cm", "lowest vertex above the object's centroid", "higher"),
            headline=True,
            distribution=True,
            caption="{:.2f} cm up",
        ),
    )

    def __call__(self, scene) -> dict[str, np.ndarray]:
        low = scene.hands.vertices[:, :, 2].min(1).astype(float) - scene.target.mesh.centroid[2]
        return {"lowest": 100 * low, "failure": np.where(low > 10, "too high", "")}


class Above(PerObject):
    """Whether the hand is above the object."""

    name = "above"
    metrics = (Metric("above", "share", "%", "grasps wholly above the object's centroid", section=Section("Toys")),)

    def __call__(self, grasps) -> dict[str, np.ndarray]:
        return {"share": (grasps.results["height/lowest"] > 0).astype(float)}


class Spread(PerMethod):
    """Mean height of all hands of a method."""

    name = "spread"
    metrics = (Metric("spread", "mean", "cm", "mean of all heights", section=Section("Toys"), per_grasp=False),)

    def __call__(self, method) -> dict:
        return {"mean": mean([np.concatenate([r["height/lowest"] for r in method.results.values()])], 10, 0)}


class Size(PerNetwork):
    """Size of a network of which nobody has published anything."""

    name = "size"
    metrics = (Metric("size", "parameters", "", "parameters of the network"),)

    def __call__(self) -> list[Score]:
        return [
            Score("FlowNet", split, name, {"parameters": 7.0}, 1) for split in ("val", "test") for name in (ALL, "ring")
        ]


TOYS = [Height, Above, Spread, Size]


@pytest.fixture(scope="module")
def settings(grabber, tiny_dataset, cache_dir, tmp_path_factory):
    """The evaluation's config for a ring, of two networks."""
    runs = tmp_path_factory.mktemp("runs")
    save_network(runs / "coarse" / "model.safetensors", grabber.generator.coarsenet, {})
    save_network(runs / "fine" / "model.safetensors", grabber.generator.refinenet, {})
    data = [f"data.root={tiny_dataset}", "data.split.val=[can]", "data.split.test=[ring]", "data.object_points=64"]
    few = ["n=4", "draws=20", "scenes=0", "processes=1", "reconstruction=false", "simulated=0", "pictures=1"]
    places = ["models=[newest]", f"runs={runs}", f"cache_dir={cache_dir}", f"data.cache_dir={cache_dir}"]
    output = tmp_path_factory.mktemp("evaluation")
    return instantiate(
        compose("evaluate", ["data=frames", *data, *few, *places, f"output={output}"]), _convert_="object"
    )


@pytest.fixture(scope="module")
def output(settings) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "PROTOCOLS", [*registry.PROTOCOLS, *TOYS])
        assert run(settings) == 0
    return Path(settings.output)


def test_json_and_csv_hold_every_kind(output):
    found = json.loads((output / "metrics.json").read_text(encoding="utf-8"))
    heights = found["metrics"]["height/lowest"]
    assert heights["definition"] == "lowest vertex above the object's centroid"
    assert list(heights["values"]) == list(found["rows"])
    with (output / "grasps.csv").open(encoding="utf-8") as file:
        grasps = list(csv.DictReader(file))
    for row in found["rows"]:
        of_row = [float(line["height/lowest (cm)"]) for line in grasps if line["row"] == row]
        assert heights["values"][row]["ring"]["value"] == pytest.approx(np.mean(of_row))
        assert heights["values"][row]["ring"]["low"] <= np.mean(of_row) <= heights["values"][row]["ring"]["high"]
        above = 100 * np.mean(np.array(of_row) > 0)
        assert found["metrics"]["above/share"]["values"][row]["all"]["value"] == pytest.approx(above)
        assert set(found["metrics"]["spread/mean"]["values"][row]) == {"all"}
    assert "above/share (%)" in grasps[0]
    assert "spread/mean (cm)" not in grasps[0]
    assert {"network": "FlowNet", "split": "val", "object": "all", "parameters": 7.0, "n": 1} in found["size"]
    with (output / "metrics.csv").open(encoding="utf-8") as file:
        lines = {(line["protocol"], line["row"], line["object"]): line for line in csv.DictReader(file)}
    assert float(lines["size", "FlowNet", "ring"]["value"]) == 7
    assert float(lines["height", "CoarseNet", "all"]["value"]) == heights["values"]["CoarseNet"]["all"]["value"]


def test_latex_holds_every_kind(output):
    latex = (output / "tables.tex").read_text(encoding="utf-8")
    first = next(line for line in latex.splitlines() if line.endswith(r"\\"))
    assert "height/lowest [cm]" in first
    assert "above/share" not in first  # no headline
    assert "% above, by object" in latex
    assert "% spread, by object" not in latex
    assert r"FlowNet & test & 7.00 \\" in latex


def test_the_report_shows_every_kind(output):
    page = (output / "report.html").read_text(encoding="utf-8")
    sections = dict(re.findall(r"<section[^>]*><h2>(.*?)</h2>(.*?)</section>", page, re.S))
    assert "lowest" in sections["At a glance"]
    for title in ("lowest", "FlowNet"):
        assert title in sections["Further protocols"]
    for title in ("share", "mean", "<summary>By object</summary>"):
        assert title in sections["Toys"]
    assert "parameters of the network" in sections["Definitions"]
    assert re.search(r"-?\d\.\d\d cm up", sections["Grasps"]) or "figcaption" not in sections["Grasps"]


def test_metrics_of_one_title_or_another_name_are_refused(settings, monkeypatch):
    class Twice(Height):
        pass

    class Foreign(Height):
        name = "foreign"

    for kind, sentence in ((Twice, "measured twice, the second time by Twice"), (Foreign, "metric of Foreign, named")):
        monkeypatch.setattr(registry, "PROTOCOLS", [Height, kind])
        with pytest.raises(ValueError, match=sentence):
            registry.protocols_of(settings)


@pytest.mark.parametrize(
    "file", ["page.py", "tables.py", "findings.py", "plots.py", "views.py", "../summary.py", "../run.py"]
)
def test_no_protocol_is_named_where_results_are_shown(file):
    source = (REPORTING / file).read_text(encoding="utf-8")
    titles = {protocol.name for protocol in registry.PROTOCOLS}
    assert len(titles) > 10
    named = {name for name in titles if re.search(rf"\b{name}\b", source)}
    assert not named
    for protocol in registry.PROTOCOLS:
        assert protocol.__name__ not in source
