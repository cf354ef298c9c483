"""Methods to compare, each a row of the tables: ground truth, naive baseline, models, grasps from folders."""

from __future__ import annotations

from dataclasses import dataclass, field

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
from grabnet.evaluation.models import treatment
from grabnet.evaluation.recorded import ground_truth_sample, recorded_hands
from grabnet.evaluation.recorded_generator import RecordedGenerator
from grabnet.evaluation.template_generator import TemplateGenerator
from grabnet.geometry.mesh import load_mesh

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


def make_methods(inputs: EvaluationInputs, without_network: bool = True) -> list[Method]:
    """Return all methods with their hands, not yet measured.

    Args:
        inputs: of the evaluation.
        without_network: the naive baseline and templates, too.

    Raises:
        UserError: grasps that cannot be read, or are of no object that is evaluated.
    """
    methods = [_ground_truth(inputs), *(_without_network(inputs) if without_network else []), *_models(inputs)]
    return methods + _folders(inputs, {method.name for method in methods})


def _ground_truth(inputs: EvaluationInputs) -> Method:
    config = inputs.config
    hands = {name: ground_truth_sample(truth, config.n, config.seed) for name, truth in inputs.truth.items()}
    about = "recorded grasps of the object, at random, held-out recordings apart"
    return Method("Ground truth", about, 0, hands, is_recorded=True)


def _without_network(inputs: EvaluationInputs) -> list[Method]:
    """The naive baseline; and, where models' grasps are optimised or chosen from candidates, what that gives without a
    network: of the baseline's grasps, and of templates.

    Raises:
        UserError: there is no training object.
    """
    config, names = inputs.config, inputs.training_objects
    if not names:
        raise UserError(f"{inputs.data.store_dir} has no training object with a mesh in {inputs.data.objects_dir}.")
    files = [inputs.files[name] for name in names]
    about = "training grasps of the object with the most similar BPS, put in the same place"
    baseline = Method("Naive baseline", about, _LAST, {}, is_recorded=True)
    similar: dict[str, Lookalike] = {}
    for name, mesh in track(inputs.meshes.items(), "Looking for similar objects"):
        similar[name] = lookalike(mesh, files, inputs.cache)
        origin = load_mesh(files[similar[name].number])
        hands = recorded_hands(inputs.training_part, inputs.hand, names[similar[name].number], origin)
        chosen = np.random.default_rng([config.seed, 3]).permutation(len(hands))[: config.n]
        baseline.hands[name] = transplanted(hands.select(chosen), origin, mesh, similar[name].turn)
        note(f"{baseline.name}: {name} is grasped like {names[similar[name].number]}")

    suffix = treatment(config.optimise, config.candidates)
    if not suffix:
        return [baseline]
    recorded, proposed = {}, {}
    for name, mesh in inputs.meshes.items():
        number, turn = similar[name]
        recorded[name] = RecordedGenerator(inputs.training_part, inputs.hand, names[number], turn)
        proposed[name] = TemplateGenerator(mesh, inputs.hand, inputs.data.cache_dir)
    rows = {
        "Naive baseline": ("recorded grasps of the same object, with the mean hand", recorded, inputs.fingerprint),
        "Templates": ("templates of human grasps where they fit the object, without any network", proposed, []),
    }
    methods = [baseline]
    for title, (about, generators, sources) in rows.items():
        hands = {}
        for name, mesh in inputs.meshes.items():
            grabber = config.treated(generators[name], inputs.hand)
            made = [title, *sources, *([str(similar[name])] if sources else [])]
            hands[name] = drawn(grabber, made, mesh, config.n, config.seed, inputs.data.cache_dir, inputs.cache)
        methods.append(Method(title + suffix, about + suffix, 2, hands))
    return methods


def _models(inputs: EvaluationInputs) -> list[Method]:
    config, methods = inputs.config, []
    for model in inputs.models:
        variants = model.variants()
        for place, (variant, grabber) in enumerate(variants.items()):
            name = model.title(variant, among=inputs.models)
            note(f"{name}: {', '.join(str(file) for file in model.files.values())}")
            sources = [variant, *model.hashes.values()]
            hands = {
                object_name: drawn(grabber, sources, mesh, config.n, config.seed, inputs.data.cache_dir, inputs.cache)
                for object_name, mesh in track(inputs.meshes.items(), f"Drawing grasps from {name}")
            }
            methods.append(Method(name, f"drawn from {model.name}", len(variants) - place, hands))
    return methods


def _folders(inputs: EvaluationInputs, taken: set[str]) -> list[Method]:
    methods = []
    for folder in inputs.config.folders:
        name = folder.name if folder.name not in taken else str(folder)
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
        taken.add(name)
        methods.append(method)
    return methods
