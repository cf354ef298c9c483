"""LightningModules: one training step of each model, with losses and the errors reported in the paper."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any

import lightning as L
import torch
from torch import Tensor, nn
from torch.distributions import Normal

from grabnet.body.hand import HandModel, HandParameters
from grabnet.cli.checks import Batch, Range, Share
from grabnet.data.batches import GraspBatch
from grabnet.data.splits import SPLITS
from grabnet.errors import UserError
from grabnet.geometry.bps import BPS
from grabnet.geometry.conventions import Conventions
from grabnet.io.files import sha256
from grabnet.losses.grasp import CoarseNetLoss, RefineNetLoss
from grabnet.models.coarsenet import CoarseNet
from grabnet.models.generator import GraspGenerator, SavedNetwork
from grabnet.models.grabnet import GrabNet
from grabnet.models.refinenet import RefineNet
from grabnet.models.trained import find_network
from grabnet.models.weights import check_conventions, check_hand, load_network
from grabnet.training.refine_inputs import RefineInput

MakeOptimizer = Callable[[Iterable[nn.Parameter]], torch.optim.Optimizer]
MakeScheduler = Callable[[torch.optim.Optimizer], Any]


class GraspTraining(L.LightningModule, ABC):
    """What the training of every model shares.

    A subclass builds its network and says how a batch is reconstructed. Where the network is a `GraspGenerator`, or
    `generator` makes one of it, grasps are sampled while it trains and with its weights afterwards.

    Args:
        network: to train.
        loss: its terms.
        hand: poses predictions.
        optimizer: makes an optimizer of the parameters.
        scheduler: makes a learning-rate schedule of an optimizer, stepped once an epoch.
        trained: weights files of the trained networks that it builds on, by kind.

    Raises:
        UserError: one of these was trained with another hand.
    """

    def __init__(
        self,
        network: nn.Module,
        loss: nn.Module,
        hand: HandModel,
        optimizer: MakeOptimizer,
        scheduler: MakeScheduler,
        trained: Mapping[str, Path],
    ):
        super().__init__()
        for path in trained.values():
            check_hand(path, hand)
        self.trained_from = {k: {"file": str(path), "sha256": sha256(path)} for k, path in trained.items()}
        self.network, self.loss, self.hand = network, loss, hand
        self.make_optimizer, self.make_scheduler = optimizer, scheduler
        # Several processes start from the same weights, sent by the first; all else is alike in them, and sparse
        # tensors cannot be sent. (The name is torch's and Lightning's.)
        self._ddp_params_and_buffers_to_ignore = [n for n, _ in self.named_buffers() if not n.startswith("network.")]

    @property
    def networks(self) -> dict[str, SavedNetwork]:
        """What to save, by folder within the run's."""
        return {"": self.network}

    def adopt(self, conventions: Conventions) -> None:
        """Train networks that know objects as the data show them.

        Raises:
            UserError: one that it builds on was trained to know them otherwise.
        """
        check_conventions({kind: Path(record["file"]) for kind, record in self.trained_from.items()}, conventions)
        for network in self.networks.values():
            network.conventions = conventions

    @property
    def generator(self) -> GraspGenerator | None:
        """The model that samples grasps with these networks; None where they cannot do it alone."""
        return self.network if isinstance(self.network, GraspGenerator) else None

    def configure_optimizers(self) -> dict[str, Any]:
        try:
            optimizer = self.make_optimizer(self.network.parameters())
            schedule = {"scheduler": self.make_scheduler(optimizer), "monitor": "val/loss", "strict": False}
        except (ValueError, TypeError) as error:
            raise UserError(f"model.optimizer or model.scheduler: {error}") from None
        return {"optimizer": optimizer, "lr_scheduler": schedule}

    def lr_scheduler_step(self, scheduler: Any, metric: Any) -> None:
        if metric is None:
            super().lr_scheduler_step(scheduler, metric)

    def on_validation_end(self) -> None:
        # Lightning steps a schedule that watches a metric only after the epoch's checkpoint is written: a resumed run
        # would be one step behind, and its learning rate fall later.
        for schedule in self.trainer.lr_scheduler_configs:
            if schedule.reduce_on_plateau and schedule.monitor in self.trainer.callback_metrics:
                schedule.scheduler.step(self.trainer.callback_metrics[schedule.monitor])

    def grasp(self, batch: GraspBatch) -> Tensor:
        """Vertices (B, V, 3) of grasps as the model makes them in use, for a batch's objects and hand shapes.

        Random numbers are those of torch's global generator.
        """
        generator = self.generator
        noise = torch.randn(len(batch), generator.noise_dim, device=batch.rest.device)
        hands = generator.sample(generator.encode(batch.objects), batch.objects, noise, batch.rest)
        return self.hand(hands, batch.rest).vertices

    @abstractmethod
    def reconstruct(self, batch: GraspBatch) -> tuple[Tensor | None, dict[str, Tensor]]:
        """Predicted vertices (B, V, 3) of a batch, None for a model that reconstructs none; and weighted loss terms."""

    def sampled_reconstruction(self, batch: GraspBatch) -> Tensor | None:
        """Reconstruct as the released evaluation does (ref. 8), from a sample where there is a posterior.

        Returns:
            vertices (B, V, 3); None for a model that reconstructs none.
        """
        return None

    def prepared(self, batch: GraspBatch) -> GraspBatch:
        """The batch with the hands to start from and those to reach: as it is where the recorded ones are reached."""
        return batch

    def training_step(self, batch: GraspBatch, batch_idx: int) -> Tensor:
        batch = self.prepared(batch)
        _, terms = self.reconstruct(batch)
        loss = torch.stack(list(terms.values())).sum()
        self._log_terms("train", terms, loss, batch)
        return loss

    def validation_step(self, batch: GraspBatch, batch_idx: int) -> None:
        self._evaluate("val", batch)

    def test_step(self, batch: GraspBatch, batch_idx: int, dataloader_idx: int = 0) -> None:
        stage = f"test/{SPLITS[dataloader_idx]}"
        self._evaluate(stage, batch)
        published = self.prepared(mean_shaped(batch, self.hand))
        self._log_errors(f"{stage}/published_", self.sampled_reconstruction(published), published)

    def _evaluate(self, stage: str, batch: GraspBatch) -> None:
        batch = self.prepared(batch)
        vertices, terms = self.reconstruct(batch)
        self._log_terms(stage, terms, torch.stack(list(terms.values())).sum(), batch)
        self._log_errors(f"{stage}/", vertices, batch)

    def _log_errors(self, before: str, vertices: Tensor | None, batch: GraspBatch) -> None:
        if vertices is not None:
            for name, value in reconstruction_errors(vertices, batch.vertices).items():
                self._log(f"{before}{name}", value.mean(), batch)

    def _log_terms(self, stage: str, terms: dict[str, Tensor], loss: Tensor, batch: GraspBatch) -> None:
        for name, value in terms.items():
            self._log(f"{stage}/{name}", value.detach(), batch)
        self._log(f"{stage}/loss", loss.detach(), batch, prog_bar=True)

    def _log(self, name: str, value: Tensor, batch: GraspBatch, **options: Any) -> None:
        self.log(
            name,
            value,
            on_step=False,
            on_epoch=True,
            batch_size=len(batch) * self.trainer.world_size,  # Lightning takes its mean over processes as an integer
            add_dataloader_idx=False,
            sync_dist=True,
            **options,
        )


class CoarseNetTraining(GraspTraining):
    """Trains CoarseNet to reconstruct grasps from its posterior.

    Args:
        hand: the hand model. contact: (V,) share of training frames in which each vertex touches.
        bps, latent_dim, width, n_hidden: of the network.
        loss: makes the loss, given hand and contact.
        optimizer, scheduler: as in `GraspTraining`.
    """

    network: CoarseNet
    loss: CoarseNetLoss

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        bps: BPS,
        latent_dim: Batch,
        width: Batch,
        n_hidden: Batch,
        loss: Callable[..., CoarseNetLoss],
        optimizer: MakeOptimizer,
        scheduler: MakeScheduler,
    ):
        network = CoarseNet(bps, latent_dim, width, n_hidden, n_joints=len(hand.parents))
        super().__init__(network, loss(hand=hand, contact=contact), hand, optimizer, scheduler, trained={})

    @property
    def generator(self) -> GrabNet:
        return GrabNet(self.network)

    def reconstruct(self, batch: GraspBatch) -> tuple[Tensor, dict[str, Tensor]]:
        guess, posterior = reconstructed(self.network, batch)
        vertices = self.hand(guess, batch.rest).vertices
        return vertices, self.loss(vertices, batch, posterior)

    def sampled_reconstruction(self, batch: GraspBatch) -> Tensor:
        return self.hand(reconstructed_from_sample(self.network, batch), batch.rest).vertices


class RefineNetTraining(GraspTraining):
    """Trains RefineNet to mend what comes near a true grasp.

    Args:
        hand: the hand model. contact: (V,) share of training frames in which each vertex touches.
        iterations, width, n_hidden, dropout: of the network.
        source: makes the hands that RefineNet starts from and those that it is to reach.
        loss: makes the loss, given hand and contact.
        optimizer, scheduler: as in `GraspTraining`.
    """

    network: RefineNet
    loss: RefineNetLoss

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        iterations: Annotated[int, Range(1, 1000)],
        width: Batch,
        n_hidden: Batch,
        dropout: Share,
        source: RefineInput,
        loss: Callable[..., RefineNetLoss],
        optimizer: MakeOptimizer,
        scheduler: MakeScheduler,
    ):
        network = RefineNet(hand, iterations, width, n_hidden, dropout)
        super().__init__(network, loss(hand=hand, contact=contact), hand, optimizer, scheduler, source.trained_from)
        self.source = source

    def prepared(self, batch: GraspBatch) -> GraspBatch:
        return self.source(batch, self.hand)

    def grasp(self, batch: GraspBatch) -> Tensor:
        """Refined from what the source gives."""
        return self.sampled_reconstruction(self.prepared(batch))

    def sampled_reconstruction(self, batch: GraspBatch) -> Tensor:
        return self.hand(refined(self.network, batch.noisy, batch), batch.rest).vertices

    def reconstruct(self, batch: GraspBatch) -> tuple[Tensor, dict[str, Tensor]]:
        vertices = self.sampled_reconstruction(batch)
        return vertices, self.loss(vertices, batch)


class GrabNetTraining(GraspTraining):
    """Trains both networks end to end: gradients of RefineNet's loss flow into CoarseNet.

    Args:
        hand: the hand model. contact: (V,) share of training frames in which each vertex touches.
        coarsenet, refinenet: run folders or weights files to start from; the newest of `find_network` when omitted.
        coarse_loss, refine_loss: make the losses of the guess and of the refined grasp, given hand and contact.
        optimizer, scheduler: as in `GraspTraining`.
    """

    network: GrabNet

    def __init__(
        self,
        hand: HandModel,
        contact: Tensor,
        coarsenet: str | None,
        refinenet: str | None,
        coarse_loss: Callable[..., CoarseNetLoss],
        refine_loss: Callable[..., RefineNetLoss],
        optimizer: MakeOptimizer,
        scheduler: MakeScheduler,
    ):
        trained = {
            "CoarseNet": find_network("CoarseNet", coarsenet),
            "RefineNet": find_network("RefineNet", refinenet),
        }
        network = GrabNet(*(load_network(file, hand, kind) for kind, file in trained.items()))
        losses = {
            "coarsenet": coarse_loss(hand=hand, contact=contact),
            "refinenet": refine_loss(hand=hand, contact=contact),
        }
        super().__init__(network.train(), nn.ModuleDict(losses), hand, optimizer, scheduler, trained)

    @property
    def networks(self) -> dict[str, SavedNetwork]:
        return {"coarsenet": self.network.coarsenet, "refinenet": self.network.refinenet}

    def reconstruct(self, batch: GraspBatch) -> tuple[Tensor, dict[str, Tensor]]:
        guess, posterior = reconstructed(self.network.coarsenet, batch)
        guessed = self.hand(guess, batch.rest).vertices
        vertices = self.hand(refined(self.network.refinenet, guess, batch), batch.rest).vertices
        terms = {f"coarse_{name}": term for name, term in self.loss["coarsenet"](guessed, batch, posterior).items()}
        return vertices, terms | self.loss["refinenet"](vertices, batch)

    def sampled_reconstruction(self, batch: GraspBatch) -> Tensor:
        guess = reconstructed_from_sample(self.network.coarsenet, batch)
        return self.hand(refined(self.network.refinenet, guess, batch), batch.rest).vertices


def reconstructed(network: CoarseNet, batch: GraspBatch) -> tuple[HandParameters, Normal]:
    """A batch's hands from CoarseNet's posterior, and that posterior."""
    return network(network.features(batch.objects), batch.hand.global_orient, batch.hand.transl)


def reconstructed_from_sample(network: CoarseNet, batch: GraspBatch) -> HandParameters:
    """A batch's hands from a sample of CoarseNet's posterior, drawn by torch's global generator, in any mode."""
    features = network.features(batch.objects)
    posterior = network.encode(features, batch.hand.global_orient, batch.hand.transl)
    return network.decode(posterior.mean + posterior.stddev * torch.randn_like(posterior.mean), features)


def mean_shaped(batch: GraspBatch, model: HandModel) -> GraspBatch:
    """The batch's poses with the model's mean shape for every subject, as the released evaluation has them (ref. 8)."""
    return batch.with_hands(model, batch.hand, model.v_template.expand_as(batch.rest))


def refined(network: RefineNet, guess: HandParameters, batch: GraspBatch) -> HandParameters:
    """What RefineNet makes of guesses at a batch's hands."""
    return network(guess, batch.objects.distances, batch.rest)


def reconstruction_errors(vertices: Tensor, true: Tensor) -> dict[str, Tensor]:
    """Of each hand (B,), in mm (ref. 9): `v2v`, the mean Euclidean distance of its vertices (B, V, 3), and `v2v_mae`,
    the mean |Δ| per coordinate (what the released evaluation averages)."""
    difference = vertices - true
    return {"v2v": 1000 * difference.norm(dim=-1).mean(-1), "v2v_mae": 1000 * difference.abs().mean((-2, -1))}
