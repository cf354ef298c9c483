"""Methods to compare, each a row of the tables: ground truth, naive baseline, models, grasps from folders."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from grabnet.cli.ends import note, say
from grabnet.cli.progress import track
from grabnet.errors import UserError
from grabnet.evaluation.baseline import Lookalike, lookalike, transplanted
from grabnet.evaluation.bootstrap import Estimate
from grabnet.evaluation.cache import Arrays
from grabnet.evaluation.generated import drawn, read_grasps
from grabnet.evaluation.hands import Hands
from grabnet.evaluation.inputs import EvaluationInputs
from grabnet.evaluation.metrics import Metric
from grabnet.evaluation.models import EvaluatedModel, treatment
from grabnet.evaluation.recorded import ground_truth_sample, recorded_hands
from grabnet.evaluation.recorded_generator import RecordedGenerator
from grabnet.evaluation.template_generator import TemplateGenerator
from grabnet.geometry.mesh import load_mesh
from grabnet.models.generator import GraspGenerator

# Rank of what is expected to come out worse than anything else.
_LAST = 100


@dataclass(eq=False)
class Method:
    """A method, its grasps of each object, and what was measured of them.

    Attributes:
        name: of its row in the tables.
        about: a sentence.
        rank: methods of a lower one are expected to come out better; None where nothing is expected.
        hands: by object.
        is_recorded: whether the hands are recorded ones, if only moved.
        results: by object, then by title: arrays, mostly with one entry for each grasp.
        estimates: of all grasps together, by title.
    """

    name: str
    about: str
    rank: int | None
    hands: dict[str, Hands]
    is_recorded: bool = False
    results: dict[str, Arrays] = field(default_factory=dict)
    estimates: dict[str, Estimate] = field(default_factory=dict)

    def values(self, metric: Metric, object_name: str) -> np.ndarray:
        """Return those of an object's grasps that count, in the metric's unit; empty where nothing was measured."""
        values = self.results.get(object_name, {}).get(metric.title)
        return np.empty(0) if values is None else values[: metric.samples].astype(float) * metric.scale


@dataclass(frozen=True)
class Row:
    """A method that can be compared, whose grasps are not made yet.

    name, rank: as the method's.
    make: the method with its hands, not yet measured. Raises a `UserError` for grasps that cannot be read or are of no
        object that is evaluated, and where a training object is needed and there is none.
    """

    name: str
    rank: int | None
    make: Callable[[], Method]


def make_methods(inputs: EvaluationInputs) -> list[Method]:
    """Return all methods with their hands, not yet measured.

    Raises:
        UserError: as `Row.make`.
    """
    return [row.make() for row in method_rows(inputs)]


def method_rows(inputs: EvaluationInputs) -> list[Row]:
    """Return what can be compared, in the order of the tables."""
    rows = [Row("Ground truth", 0, partial(_ground_truth, inputs))]
    rows += [*_WithoutNetwork(inputs).rows(), *_models(inputs)]
    names = {row.name for row in rows}
    for folder in inputs.config.folders:
        name = folder.name if folder.name not in names else str(folder)
        names.add(name)
        rows.append(Row(name, None, partial(_folder, inputs, folder, name)))
    return rows


def _ground_truth(inputs: EvaluationInputs) -> Method:
    config = inputs.config
    hands = {name: ground_truth_sample(truth, config.n, config.seed) for name, truth in inputs.truth.items()}
    about = "recorded grasps of the object, at random, held-out recordings apart"
    return Method("Ground truth", about, 0, hands, is_recorded=True)


class _WithoutNetwork:
    """The naive baseline; and, where models' grasps are optimised or chosen from candidates, what that gives without a
    network: of the baseline's grasps, and of templates."""

    def __init__(self, inputs: EvaluationInputs):
        self._inputs = inputs
        self._suffix = treatment(inputs.config.optimise, inputs.config.candidates)

    def rows(self) -> list[Row]:
        rows = [Row("Naive baseline", _LAST, self._baseline)]
        if self._suffix:
            rows.append(Row(f"Naive baseline{self._suffix}", 2, self._recorded))
            rows.append(Row(f"Templates{self._suffix}", 2, self._templates))
        return rows

    @cached_property
    def _similar(self) -> dict[str, Lookalike]:
        """The training object that each evaluated one looks most like.

        Raises:
            UserError: there is no training object.
        """
        inputs = self._inputs
        if not inputs.training_objects:
            raise UserError(f"{inputs.data.store_dir} has no training object with a mesh in {inputs.data.objects_dir}.")
        files = [inputs.files[name] for name in inputs.training_objects]
        meshes = track(inputs.meshes.items(), "Looking for similar objects")
        return {name: lookalike(mesh, files, inputs.cache) for name, mesh in meshes}

    def _baseline(self) -> Method:
        inputs, config, hands = self._inputs, self._inputs.config, {}
        for name, (number, turn) in self._similar.items():
            source = inputs.training_objects[number]
            origin = load_mesh(inputs.files[source])
            recorded = recorded_hands(inputs.training_part, inputs.hand, source, origin)
            chosen = np.random.default_rng([config.seed, 3]).permutation(len(recorded))[: config.n]
            hands[name] = transplanted(recorded.select(chosen), origin, inputs.meshes[name], turn)
            note(f"Naive baseline: {name} is grasped like {source}")
        about = "training grasps of the object with the most similar BPS, put in the same place"
        return Method("Naive baseline", about, _LAST, hands, is_recorded=True)

    def _recorded(self) -> Method:
        inputs, part = self._inputs, self._inputs.training_part
        generators = {
            name: RecordedGenerator(part, inputs.hand, inputs.training_objects[number], turn)
            for name, (number, turn) in self._similar.items()
        }
        sources = {name: [*inputs.fingerprint, str(found)] for name, found in self._similar.items()}
        return self._treated(
            "Naive baseline", "recorded grasps of the same object, with the mean hand", generators, sources
        )

    def _templates(self) -> Method:
        inputs = self._inputs
        generators = {
            name: TemplateGenerator(mesh, inputs.hand, inputs.data.cache_dir) for name, mesh in inputs.meshes.items()
        }
        return self._treated(
            "Templates", "templates of human grasps where they fit the object, without any network", generators, {}
        )

    def _treated(
        self,
        title: str,
        about: str,
        generators: Mapping[str, GraspGenerator],
        sources: Mapping[str, Sequence[str]],
    ) -> Method:
        inputs, config, hands = self._inputs, self._inputs.config, {}
        for name, mesh in inputs.meshes.items():
            grabber = config.treated(generators[name], inputs.hand)
            made = [title, *sources.get(name, [])]
            hands[name] = drawn(grabber, made, mesh, config.n, config.seed, inputs.data.cache_dir, inputs.cache)
        return Method(title + self._suffix, about + self._suffix, 2, hands)


def _models(inputs: EvaluationInputs) -> list[Row]:
    rows = []
    for model in inputs.models:
        variants = model.variants()
        for place, variant in enumerate(variants):
            name, rank = model.title(variant, among=inputs.models), len(variants) - place
            rows.append(Row(name, rank, partial(_variant, inputs, model, variant, name, rank)))
    return rows


def _variant(inputs: EvaluationInputs, model: EvaluatedModel, variant: str, name: str, rank: int) -> Method:
    config, grabber = inputs.config, model.variants()[variant]
    note(f"{name}: {', '.join(str(file) for file in model.files.values())}")
    sources = [variant, *model.hashes.values()]
    hands = {
        object_name: drawn(grabber, sources, mesh, config.n, config.seed, inputs.data.cache_dir, inputs.cache)
        for object_name, mesh in track(inputs.meshes.items(), f"Drawing grasps from {name}")
    }
    return Method(name, f"drawn from {model.name}", rank, hands)


def _folder(inputs: EvaluationInputs, folder: Path, name: str) -> Method:
    read = {
        object_name: read_grasps(folder, object_name, inputs.files[object_name], inputs.hand, inputs.config.n)
        for object_name in track(inputs.objects, f"Reading {folder}")
    }
    method = Method(name, f"grasps in {folder}", None, {k: hands for k, hands in read.items() if hands is not None})
    missing = ", ".join(object_name for object_name in read if object_name not in method.hands)
    if not method.hands:
        raise UserError(f"{folder} has no folder called like an object; these are {missing}.")
    if missing:
        say(f"{name} has no grasps of {missing}.")
        method.about += f", which has none of {missing}"
    return method
