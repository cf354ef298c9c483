"""The rows of the tables: ground truth, naive baseline, networks, and grasps made elsewhere."""

from __future__ import annotations

import numpy as np

from grabnet.errors import UserError
from grabnet.evaluation.baseline import lookalike, transplanted
from grabnet.evaluation.generated import drawn, read_grasps
from grabnet.evaluation.inputs import Material, Networks
from grabnet.evaluation.protocols.ground_truth import ground_truth_row, recorded_hands
from grabnet.evaluation.summary import Row
from grabnet.geometry.mesh import load_mesh


def make_rows(material: Material, networks: Networks) -> list[Row]:
    """All rows with their hands, not yet measured.

    Raises:
        UserError: grasps that cannot be read, or are of no object that is evaluated.
    """
    rows = [_ground_truth(material), _baseline(material), *_networks(material, networks)]
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
        hands = recorded_hands(material.training_part, material.hand, names[found.number], origin)
        chosen = np.random.default_rng([material.wanted.seed, 3]).permutation(len(hands))[: material.wanted.n]
        row.hands[name] = transplanted(hands.select(chosen), origin, mesh, found.turn)
        print(f"{row.name}: {name} is grasped like {names[found.number]}")
    return row


def _networks(material: Material, networks: Networks) -> list[Row]:
    wanted, rows = material.wanted, []
    for used in (["coarsenet"], ["coarsenet", "refinenet"]):
        if not set(used) <= set(networks.files):
            continue
        refine = "refinenet" in used
        name, rank = ("CoarseNet + RefineNet", 1) if refine else ("CoarseNet", 2)
        print(f"{name}: {', '.join(str(networks.files[network]) for network in used)}")
        grabber, hashes = networks.grabber(material.hand, refine), [networks.hashes[network] for network in used]
        hands = {
            thing: drawn(grabber, hashes, mesh, wanted.n, wanted.seed, material.data.cache_dir, material.cache)
            for thing, mesh in material.meshes.items()
        }
        rows.append(Row(name, "drawn from the network" + "s" * refine, rank, hands))
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
