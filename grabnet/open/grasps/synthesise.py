"""Synthesis of grasps: propose, optimise, check, simulate, until each object has its share for each subject."""

from __future__ import annotations

import multiprocessing
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.body.hand import HandModel
from grabnet.grasping.grasp_hand import GraspHand, GraspPose
from grabnet.grasping.proposing.grasped_object import GraspedObject
from grabnet.grasping.proposing.posture import PostureConfig
from grabnet.grasping.proposing.proposals import KIND_NAMES, ProposalConfig, propose
from grabnet.grasping.proposing.templates import Template, TemplateConfig, build_templates, natural_limits
from grabnet.open.grasps.checks import AcceptanceConfig, GraspMeasures, measure, verdicts
from grabnet.open.grasps.energy import EnergyConfig
from grabnet.open.grasps.optimise import SynthesisDescentConfig, optimise
from grabnet.open.grasps.scene import open_object
from grabnet.open.grasps.stability import StabilityConfig, cut, holds
from grabnet.open.objects import OBJECTS
from grabnet.physics.hand_pieces import hand_pieces
from grabnet.physics.simulation import RigidBody


@dataclass(frozen=True)
class SynthesisConfig:
    """All numbers of a run."""

    per_object: int = 220
    subjects_per_object: int = 5  # of 10, a different selection for each object
    batch: int = 96  # proposals at once
    max_rounds: int = 4  # batches per subject before an object goes short
    hopeless: float = 0.08  # share of a batch below which no more of that half (on the table, or held) are sought
    betas_spread: float = 0.7  # of the shape coefficients, 1 being the population's
    size_by_sex: float = 0.8  # mean first coefficient (hand size) of men; women have its negative
    templates: TemplateConfig = field(default_factory=TemplateConfig)
    proposals: ProposalConfig = field(default_factory=ProposalConfig)
    posture: PostureConfig = field(default_factory=PostureConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    optimiser: SynthesisDescentConfig = field(default_factory=SynthesisDescentConfig)
    acceptance: AcceptanceConfig = field(default_factory=AcceptanceConfig)
    stability: StabilityConfig = field(default_factory=StabilityConfig)


SUBJECTS = tuple(f"s{i}" for i in range(1, 11))
GENDERS = ("female",) * 5 + ("male",) * 5


@dataclass(frozen=True)
class ObjectGrasps:
    """N accepted grasps of one object, in its frame, and what it took.

    subject, kind: (N,) indices into SUBJECTS and KIND_NAMES. clears_table: (N,) bool. pose: B = N hands.
    report: numbers for the object's row.
    """

    name: str
    mesh_sha256: str
    subject: Tensor
    kind: Tensor
    clears_table: Tensor
    pose: GraspPose
    transl: Tensor
    report: dict


def subject_betas(config: SynthesisConfig, seed: int) -> Tensor:
    """(10, 10) hand shapes of the subjects, five women and five men."""
    generator = torch.Generator().manual_seed(seed)
    betas = config.betas_spread * torch.randn(len(SUBJECTS), 10, generator=generator).clamp(-2, 2)
    betas[:, 0] = betas[:, 0] * 0.5
    betas[:, 0] += config.size_by_sex * torch.tensor([-1.0 if gender == "female" else 1.0 for gender in GENDERS])
    return betas


def synthesise(names: Sequence[str], config: SynthesisConfig, seed: int, processes: int) -> Iterator[ObjectGrasps]:
    """Grasps of each object, as they are done; each depends on its name and the seed only."""
    torch.set_num_threads(1)  # sums in another order would give other grasps
    hand = HandModel.open()
    anatomy = Anatomy.of(hand)
    limits = natural_limits(anatomy, config.templates)
    templates = build_templates(GraspHand(hand, anatomy, torch.zeros(10)), limits, config.templates)
    plain = {kind: tuple(template) for kind, template in templates.items()}
    job = partial(_object_job, templates=plain, config=config, seed=seed)
    if processes == 1:
        yield from map(job, names)
        return
    with ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(job, name) for name in names]):
            yield done.result()


def _object_job(name: str, templates: dict[str, tuple], config: SynthesisConfig, seed: int) -> ObjectGrasps:
    torch.set_num_threads(1)
    scene = open_object(name)
    first = sorted(OBJECTS).index(name)
    chosen = [(first + 2 * i + (i >= 5)) % len(SUBJECTS) for i in range(config.subjects_per_object)]
    return grasp_object(scene, {k: Template(*t) for k, t in templates.items()}, chosen, config, seed)


def grasp_object(
    scene: GraspedObject, templates: dict[str, Template], subjects: Sequence[int], config: SynthesisConfig, seed: int
) -> ObjectGrasps:
    """`config.per_object` grasps of one object, shared evenly between the subjects, half of them above a table.

    What can't be had on the table (or in the hand) is made up for by the other half; where an object is hard to hold
    altogether, it ends up with fewer.
    """
    hand_model = HandModel.open()
    anatomy = Anatomy.of(hand_model)
    limits, betas = natural_limits(anatomy, config.templates), subject_betas(config, seed)
    generator = torch.Generator().manual_seed(zlib.crc32(scene.name.encode()) + (seed << 32))
    rigid = _rigid(scene, config.stability)
    kept: list[_Batch] = []
    counts = Counter()
    for position, subject in enumerate(subjects):
        quota = config.per_object * (position + 1) // len(subjects) - config.per_object * position // len(subjects)
        hand = GraspHand(hand_model, anatomy, betas[subject])
        pieces = hand_pieces(hand.weights.numpy(), hand.rest.numpy())
        left = {True: round(quota * config.proposals.on_table)}  # on the table
        left[False] = quota - left[True]  # held
        for _ in range(config.max_rounds):
            if not any(left.values()):
                break
            shares = replace(config.proposals, on_table=left[True] / sum(left.values()))
            starts = propose(scene, hand, templates, config.batch, generator, shares, config.posture)
            pose = optimise(scene, hand, starts, limits, generator, config.optimiser, config.energy, config.posture)
            with torch.no_grad():
                measures = measure(scene, hand, pose, starts, config.acceptance, config.posture)
                vertices = hand.posed(pose).vertices.numpy()
            passed = verdicts(measures, starts.on_table, config.acceptance)
            accepted = torch.stack(list(passed.values())).all(0)
            counts.update({f"rejected: {condition}": int((~ok).sum()) for condition, ok in passed.items()})
            counts.update(proposals=len(accepted), accepted=int(accepted.sum()))

            tried = Counter(starts.on_table.tolist())
            wanted = dict(left)
            stable = []
            for i in torch.where(accepted)[0].tolist():
                on_table = bool(starts.on_table[i])
                if not left[on_table]:
                    continue
                near = measures.distance[i].numpy() < 1e3 * config.stability.near
                solids = [vertices[i, piece] for piece in pieces if near[piece].any()]
                held = holds(rigid, solids, config.stability)
                counts.update(simulated=1, stable=int(held))
                if held:
                    stable.append(i)
                    left[on_table] -= 1
            for flag in (True, False):
                if left[flag] and wanted[flag] - left[flag] < config.hopeless * tried[flag]:
                    left[not flag] += left[flag]
                    left[flag] = 0
            chosen = torch.tensor(stable, dtype=torch.int64)
            kept.append(
                _Batch(
                    torch.full_like(chosen, subject),
                    starts.kind[chosen],
                    pose.wrist[chosen] - hand.joints[0],
                    pose.select(chosen),
                    GraspMeasures(*(x[chosen] for x in measures)),
                )
            )
    return _gather(scene, kept, counts, config)


class _Batch(NamedTuple):
    subject: Tensor
    kind: Tensor
    transl: Tensor
    pose: GraspPose
    measures: GraspMeasures


def _rigid(scene: GraspedObject, config: StabilityConfig) -> RigidBody:
    points = torch.tensor(scene.mesh.vertices)
    inward = -torch.tensor(scene.mesh.trimesh().vertex_normals.copy(), dtype=torch.float32)
    first_exit = torch.zeros(len(points), dtype=torch.bool)
    return cut(scene.mesh, scene.thickness(points, inward, first_exit, reach=0.012).numpy(), config)


def _gather(scene: GraspedObject, kept: list[_Batch], counts: Counter, config: SynthesisConfig) -> ObjectGrasps:
    subject, kind, transl = (torch.cat(x) for x in list(zip(*kept, strict=True))[:3])
    measures = GraspMeasures(*(torch.cat(x) for x in zip(*(batch.measures for batch in kept), strict=True)))
    pose = GraspPose(*(torch.cat(x) for x in zip(*(batch.pose for batch in kept), strict=True)))
    fingers = (measures.contacts[:, :5] >= config.acceptance.vertices_per_finger).sum(1)
    clears = measures.below_table <= config.acceptance.below_table

    def mean(values: Tensor) -> float | None:
        return round(float(values.float().mean()), 3) if len(values) else None

    report = {
        "grasps": len(kind),
        "accepted": round(counts["accepted"] / max(counts["proposals"], 1), 3),
        "stable": round(counts["stable"] / max(counts["simulated"], 1), 3),
        "clear_of_table": mean(clears),
        "max_penetration_mm": mean(measures.max_depth),
        "worst_penetration_mm": round(float(measures.max_depth.amax()), 3) if len(kind) else None,
        "mean_penetration_mm": mean(measures.mean_depth),
        "contact_vertices": mean((measures.distance < 4.5).sum(1)),
        "fingers_in_contact": mean(fingers),
        "palm_in_contact": mean(measures.contacts[:, 5] >= 5),
        "subjects": len(subject.unique()),
        "kinds": dict(zip(KIND_NAMES, kind.bincount(minlength=len(KIND_NAMES)).tolist(), strict=True)),
        "counts": dict(counts),
    }
    return ObjectGrasps(scene.name, scene.mesh.sha256, subject, kind, clears, pose, transl, report)
