"""What is watched while a network trains: the grasps it makes of validation objects, and how fast it goes."""

from __future__ import annotations

import logging
import time
from copy import deepcopy
from pathlib import Path
from typing import Any

import lightning as L
import numpy as np
import torch
from lightning.pytorch.loggers import WandbLogger
from torch import Tensor

from grabnet.body.anatomy import Anatomy
from grabnet.cli.checks import Amount, Count, Seed
from grabnet.contact.contacts import Contacts
from grabnet.data.batches import GraspBatch
from grabnet.data.datamodule import GraspDataModule
from grabnet.grasping.grasp_hand import GraspHand
from grabnet.grasping.interior import Interior
from grabnet.grasping.walls import depth_through_walls
from grabnet.training.modules import GraspTraining
from grabnet.visual.pictures import SKIN, Shape, can_render, contact_sheet, save_image
from grabnet.visual.views import both_sides

log = logging.getLogger(__name__)


class GraspMonitor(L.Callback):
    """The same grasps of validation objects, measured each epoch as `val_grasps/…` and drawn every few.

    CoarseNet's are from random codes, RefineNet's from what it learns from (disturbed true grasps); codes and
    disturbances never change. The random numbers of training are left as they are.

    Args:
        grasps: how many are measured: one for each of so many validation frames, evenly spaced.
        pictures: how many of them are drawn.
        draw_every_n_epochs: between two pictures.
        folder: gets `epoch_XXXX.png`; wandb gets the same picture where that logger is chosen.
        seed: of codes and disturbances.
    """

    def __init__(self, grasps: Count, pictures: Amount, draw_every_n_epochs: Count, folder: str, seed: Seed):
        self.n_grasps, self.n_pictures, self.draw_every_n_epochs = grasps, pictures, draw_every_n_epochs
        self.folder, self.seed = Path(folder), seed
        self.hand: GraspHand | None = None

    @torch.no_grad()
    def on_validation_epoch_end(self, trainer: L.Trainer, pl_module: GraspTraining) -> None:
        data: GraspDataModule = trainer.datamodule
        device = pl_module.device
        chosen = _evenly(self.n_grasps, len(data.frames("val")))
        with torch.random.fork_rng([device] if device.type == "cuda" else []):
            torch.manual_seed(self.seed)
            batch = data.assemble("val", chosen.to(device))
            vertices = pl_module.grasp(batch)
        if self.hand is None:
            model = deepcopy(data.hand).cpu()
            self.hand = GraspHand(model, Anatomy.of(model), model.shapedirs.new_zeros(model.shapedirs.shape[-1]))
            self.interior = Interior.of(self.hand)
        contacts = Contacts(
            distances=batch.objects.signed_distances(vertices),
            finger=self.hand.anatomy.finger.to(device),
            contact_distance=data.contact_distance,
        )
        posed = self.interior.posed(vertices)
        through = depth_through_walls(batch.objects.signed_distances, self.hand, posed).amax(1)
        figures = {
            "max_penetration_mm": 1000 * contacts.max_penetration,
            "through_mm": through,
            "pinched": contacts.pinched.float(),
            "contact_vertices": contacts.contact_vertices.sum(1).float(),
        }
        for name, values in figures.items():
            pl_module.log(f"val_grasps/{name}", values.mean(), batch_size=1, sync_dist=True)  # alike in all processes
        due = (trainer.current_epoch + 1) % self.draw_every_n_epochs == 0
        if due and self.n_pictures and trainer.is_global_zero:
            self._draw(trainer, batch, vertices, contacts, through)

    def _draw(
        self, trainer: L.Trainer, batch: GraspBatch, vertices: Tensor, contacts: Contacts, through: Tensor
    ) -> None:
        if reason := can_render():
            log.warning(reason)
            self.n_pictures = 0
            return
        data: GraspDataModule = trainer.datamodule
        objects, faces = data.assembler.object_set, data.hand.faces
        tiles, captions = [], []
        for k in _evenly(self.n_pictures, len(batch)).tolist():
            number = int(batch.objects.index[k])
            mesh = objects.meshes[number]
            centre = objects.centres[number].cpu().numpy()
            solid = (mesh.vertices - centre) @ batch.objects.rotations[k].mT.cpu().numpy()
            hand = Shape(vertices[k].cpu(), faces.cpu(), SKIN)
            tiles.append(both_sides(Shape(solid, mesh.faces), hand, np.array([0.0, 0, 1]), np.array([0.0, 1, 0]), 200))
            deep = f"{1000 * contacts.max_penetration[k]:.1f} mm deep, {through[k]:.0f} mm through walls"
            captions.append(f"{objects.names[number]}: {deep}")
        sheet = contact_sheet(tiles, captions)
        save_image(self.folder / f"epoch_{trainer.current_epoch:04d}.png", sheet)
        for logger in trainer.loggers:
            if isinstance(logger, WandbLogger):
                logger.log_image("val_grasps/pictures", [sheet], step=trainer.global_step)


class SpeedMonitor(L.Callback):
    """Mean time of a training step and frames per second, over the steps of each epoch: `speed/…`.

    Waits for the device once an epoch, at its last step, not in between.
    """

    def on_train_epoch_start(self, trainer: L.Trainer, pl_module: L.LightningModule) -> None:
        self.frames, self.steps, self.start = 0, 0, time.perf_counter()

    def on_train_batch_end(
        self, trainer: L.Trainer, pl_module: L.LightningModule, outputs: Any, batch: GraspBatch, batch_idx: int
    ) -> None:
        self.frames += len(batch) * trainer.world_size
        self.steps += 1
        if trainer.is_last_batch:
            if pl_module.device.type == "cuda":
                torch.cuda.synchronize(pl_module.device)
            seconds = time.perf_counter() - self.start
            figures = {"speed/step_ms": 1000 * seconds / self.steps, "speed/frames_per_s": self.frames / seconds}
            for logger in trainer.loggers:  # shown only: no metric of the epoch, as it differs from run to run
                logger.log_metrics(figures | {"epoch": trainer.current_epoch}, step=trainer.global_step)


def _evenly(n: int, of: int) -> Tensor:
    """Up to n of the numbers 0 … of - 1, evenly spaced."""
    return torch.linspace(0, of - 1, min(n, of), dtype=torch.float64).round().long()
