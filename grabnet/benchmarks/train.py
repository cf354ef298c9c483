"""One training step of each network: beside the bare network's, and beside the same losses in plain torch."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy

import torch
from hydra.utils import instantiate
from lightning.pytorch.plugins import MixedPrecision, Precision
from torch import Tensor

from grabnet.benchmarks.run import BenchmarkConfig
from grabnet.benchmarks.timing import Case
from grabnet.body.anatomy import vertex_normals
from grabnet.cli.entry import compose
from grabnet.data.datamodule import GraspDataModule
from grabnet.geometry.rotations import matrix_to_six_d
from grabnet.losses.terms import hand_to_object_l1, object_to_hand_l1, vertex_l1
from grabnet.training.acceleration import compile_blocks, set_matmul_precision
from grabnet.training.modules import CoarseNetTraining, GraspTraining

# What may make the full step faster, where the hardware offers it.
SWITCHES = ("compile=true", "matmul_precision=medium", "trainer.precision=bf16-mixed")


def cases(settings: BenchmarkConfig) -> list[Case]:
    found = []
    for model in ("coarsenet", "refinenet"):
        overrides = [f"model={model}", f"data.batch_size={settings.batch}", f"data.max_frames={settings.batch}"]
        step = Step.make(settings, [*overrides, *settings.train])
        bare, plain, full = (f"{model}, {what}" for what in ("network alone", "plain torch losses", "full step"))
        found += [
            Case(bare, step.bare),
            Case(plain, step.plain, (bare,), runs=2),
            Case(full, step.full, (bare, plain)),
        ]
        for switch in SWITCHES:
            other = Step.make(settings, [*overrides, *settings.train, switch])
            found.append(Case(f"{full}, {switch}", other.full, (full,)))
    return found


class Step:
    """One network's training step on a fixed choice of frames, with all or a part of what belongs to it.

    Args:
        data: set up. module: on the same device, in training mode. precision: of the trainer. matmul_precision: of
            products of float32, as in `configs/train.yaml`.
    """

    def __init__(self, data: GraspDataModule, module: GraspTraining, precision: Precision, matmul_precision: str):
        self.data, self.module, self.precision, self.matmul_precision = data, module, precision, matmul_precision
        self.optimizer = module.make_optimizer(module.network.parameters())
        # Of its own: what the bare step descends soon takes the hands far from the objects, where measuring them takes
        # another time than in training.
        self.alone = deepcopy(module.network)
        self.alone_optimizer = module.make_optimizer(self.alone.parameters())
        self.index = torch.arange(len(data.frames("train")), device=module.hand.v_template.device)
        self.batch = data.assemble("train", self.index, turn=True)
        faces = module.hand.faces
        self.edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).sort(-1).values.unique(dim=0)
        if isinstance(module, CoarseNetTraining):
            self.features = module.network.features(self.batch.objects)

    @classmethod
    def make(cls, settings: BenchmarkConfig, overrides: list[str]) -> Step:
        """Step of the networks and data that `configs/train.yaml` and overrides describe."""
        cfg = compose("train", overrides)
        torch.manual_seed(settings.seed)
        hand = instantiate(cfg.hand_model)
        data: GraspDataModule = instantiate(cfg.data, hand=hand)
        data.prepare_data()
        data.setup()
        module: GraspTraining = instantiate(cfg.model, hand=hand, contact=data.contact)
        name = cfg.trainer.precision
        precision = MixedPrecision(name, settings.device) if name.endswith("-mixed") else Precision()
        step = cls(data, module.to(settings.device).train(), precision, cfg.matmul_precision)
        if cfg.compile:
            compile_blocks(module.network)
            compile_blocks(step.alone)
        return step

    def full(self) -> None:
        """Batch assembly, basis points, network, hands, all losses, Adam."""
        batch = self.data.assemble("train", self.index, turn=True)
        self._descend(lambda: _total(self.module.reconstruct(self.module.prepared(batch))[1]), self.optimizer)

    def bare(self) -> None:
        """The network's layers, forward and backward, and Adam."""
        self._descend(self._bare_output, self.alone_optimizer)

    def plain(self) -> None:
        """As published: batch and basis points come from disk, all else is compared again in every step."""
        self._descend(lambda: _total(self.plain_terms()), self.optimizer)

    def plain_terms(self) -> dict[str, Tensor]:
        """The loss of the step's batch, by cdist: the module's own with `data.distance_to=samples`."""
        batch, module, network = self.batch, self.module, self.module.network
        placed = batch.objects
        points = self.data.assembler.object_set.points[placed.index] @ placed.rotations.mT
        if isinstance(module, CoarseNetTraining):
            hand, posterior = network(self.features, batch.hand.global_orient, batch.hand.transl)
        else:
            hand = network(module.prepared(batch).noisy, lambda v: _nearest_distance(v, points), batch.rest)
        vertices = module.hand(hand, batch.rest).vertices
        loss = module.loss
        error = {
            "vertex": vertex_l1(vertices, batch.vertices, loss.vertex_weight),
            "edge": _along(self.edges, vertices - batch.vertices).abs().mean(),
            "hand_to_object": hand_to_object_l1(
                _nearest_distance(vertices, points),
                _nearest_distance(batch.vertices, points),
                loss.distance_weight,
            ),
        }
        if isinstance(module, CoarseNetTraining):
            reached, true = (_signed_distance(points, v, module.hand.faces) for v in (vertices, batch.vertices))
            error["object_to_hand"] = object_to_hand_l1(reached, true, loss.point_weights)
        scale = 1 - loss.kl if isinstance(module, CoarseNetTraining) else loss.scale
        terms = {name: scale * getattr(loss, name) * value for name, value in error.items()}
        if isinstance(module, CoarseNetTraining):
            divergence = torch.distributions.kl_divergence(posterior, _standard(posterior.mean))
            terms["kl"] = loss.kl * divergence.sum(-1).mean()
        return terms

    def _bare_output(self) -> Tensor:
        """Something to descend of what the layers give."""
        network, hand = self.alone, self.batch.hand
        if isinstance(self.module, CoarseNetTraining):
            out, posterior = network(self.features, hand.global_orient, hand.transl)
            return out.rotations.sum() + out.transl.sum() + (posterior.mean + posterior.stddev).sum()
        pose, transl = matrix_to_six_d(hand.rotations).flatten(1), hand.transl
        for _ in range(network.iterations):
            pose_change, transl_change = network.correction(self.batch.distances, pose, transl)
            pose, transl = pose + pose_change, transl + transl_change
        return pose.sum() + transl.sum()

    def _descend(self, loss: Callable[[], Tensor], optimizer: torch.optim.Optimizer) -> None:
        """One step, as exact as the trainer makes it."""
        before = torch.get_float32_matmul_precision()
        set_matmul_precision(self.matmul_precision)
        try:
            with self.precision.forward_context():
                value = loss()
            optimizer.zero_grad()
            value.backward()
            optimizer.step()
        finally:
            set_matmul_precision(before)


def _total(terms: dict[str, Tensor]) -> Tensor:
    return torch.stack(list(terms.values())).sum()


def _standard(like: Tensor) -> torch.distributions.Normal:
    return torch.distributions.Normal(torch.zeros_like(like), torch.ones_like(like))


def _along(edges: Tensor, of: Tensor) -> Tensor:
    """(B, E, 3), from start to end of each edge, of what is at the vertices (B, V, 3)."""
    return of[:, edges[:, 1]] - of[:, edges[:, 0]]


@torch.no_grad()
def _nearest(queries: Tensor, points: Tensor, chunk: int = 32) -> Tensor:
    """Index of the nearest of points (B, N, 3), repeated for its coordinates (B, Q, 3); of `chunk` rows at a time."""
    pieces = zip(queries.split(chunk), points.split(chunk), strict=True)
    return torch.cat([torch.cdist(q, p).argmin(-1) for q, p in pieces]).unsqueeze(-1).expand(-1, -1, 3)


def _nearest_distance(queries: Tensor, points: Tensor) -> Tensor:
    return (queries - points.gather(1, _nearest(queries, points))).norm(dim=-1)


def _signed_distance(queries: Tensor, vertices: Tensor, faces: Tensor) -> Tensor:
    index = _nearest(queries, vertices)
    offset = queries - vertices.gather(1, index)
    behind = (offset.detach() * vertex_normals(vertices.detach(), faces).gather(1, index)).sum(-1) < 0
    return torch.where(behind, -1.0, 1.0) * offset.norm(dim=-1)
