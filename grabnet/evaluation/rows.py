"""The rows of the tables: ground truth, naive baseline, networks, and grasps made elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from grabnet.errors import UserError
from grabnet.evaluation.baseline import lookalike, transplanted
from grabnet.evaluation.generated import drawn, read_grasps
from grabnet.evaluation.inputs import Material
from grabnet.evaluation.models import EvaluatedModel
from grabnet.evaluation.protocols.ground_truth import ground_truth_row, recorded_hands
from grabnet.evaluation.summary import Row
from grabnet.geometry.mesh import load_mesh


def make_rows(material: Material, models: Sequence[EvaluatedModel]) -> list[Row]:
    """All rows with their hands, not yet measured.

    Raises:
        UserError: grasps that cannot be read, or are of no object that is evaluated.
    """
    rows = [_ground_truth(material), _baseline(material), *_models(material, models)]
    return rows + _elsewhere(material, {row.name for row in rows})


def _ground_truth(material: Material) -> Row:
    wanted = material.wanted
    hands = {name: ground_truth_row(truth, wanted.n, wanted.seed) for name, truth in material.truth.items()}
    about = "recorded grasps of the object, at random, held-out recordings apart"
    return Row("Ground truth", about, 0, hands, true_hands=True)


def _baseline(material: Material) -> Row:
    """Raises: UserError: there is no training object."""
    about = "training grasps of the object with the most similar BPS, put in the same place"
    row = Row("Naive baseline", about, 3, {}, true_hands=True)
    names = material.training_objects
    if not names:
        raise UserError(f"{material.data.store_dir} has no training object with a mesh in {material.data.objects_dir}.")
    files = [material.files[name] for name in names]
    for name, mesh in material.meshes.items():
        found = lookalike(mesh, files, material.cache)
        origin = load_mesh(files[found.number])
        hands = recorded_hands(material.store, material.hand, names[found.number], origin)
        chosen = np.random.default_rng([material.wanted.seed, 3]).permutation(len(hands))[: material.wanted.n]
        row.hands[name] = transplanted(hands.select(chosen), origin, mesh, found.turn)
        print(f"{row.name}: {name} is grasped like {names[found.number]}")
    return row


def _models(material: Material, models: Sequence[EvaluatedModel]) -> list[Row]:
    config, rows = material.wanted, []
    for model in models:
        variants = model.variants()
        for k, (variant, grabber) in enumerate(variants.items()):
            name = variant if len(models) == 1 else f"{model.name}: {variant}"
            print(f"{name}: {', '.join(str(file) for file in model.files.values())}")
            hashes = [variant, *model.hashes.values()]
            hands = {
                object_name: drawn(
                    grabber, hashes, mesh, config.n, config.seed, material.data.cache_dir, material.cache
                )
                for object_name, mesh in material.meshes.items()
            }
            whole = k == len(variants) - 1
            rows.append(Row(name, f"drawn from {model.name}", 1 if whole else 2, hands))
    return rows


def _elsewhere(material: Material, taken: set[str]) -> list[Row]:
    rows = []
    for folder in material.wanted.folders:
        name = folder.name if folder.name not in taken else str(folder)
        read = {
            thing: read_grasps(folder, thing, material.files[thing], material.hand, material.wanted.n)
            for thing in material.objects
        }
        left_out = ", ".join(thing for thing, hands in read.items() if hands is None)
        row = Row(
            name, f"grasps in {folder}", None, {thing: hands for thing, hands in read.items() if hands is not None}
        )
        if not row.hands:
            raise UserError(f"{folder} has no folder called like an object; these are {left_out}.")
        if left_out:
            print(f"{name} has no grasps of {left_out}")
            row.about += f", which has none of {left_out}"
        taken.add(name)
        rows.append(row)
    return rows
