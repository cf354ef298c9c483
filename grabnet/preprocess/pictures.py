"""What preprocessing found, drawn: frames left by each rule, and where hands touch."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import torch
from matplotlib import colormaps
from matplotlib.figure import Figure
from torch import Tensor

from grabnet.body.hand import HandModel, HandParameters
from grabnet.io.files import replacing
from grabnet.preprocess.filtering import Waterfall
from grabnet.visual.pictures import Shape, can_render, contact_sheet, render, save_image

_GREY, _BLUE, _RED = "#d5dbe1", "#4f7cac", "#c8553d"
# A flat right hand from palm, back and thumb's side: direction to the viewer, and what points up.
_VIEWS = {"palm": ((0, -1, 0), (-1, 0, 0)), "back": ((0, 1, 0), (-1, 0, 0)), "thumb": ((0.2, -0.3, 1), (-1, 0, 0))}


@mpl.rc_context({"text.parse_math": False})  # names are no formulas
def draw_waterfall(waterfall: Waterfall, path: Path) -> None:
    """How many frames each rule takes away: of all, and by split, intent and object what share it leaves."""
    in_all = waterfall.by()[()]
    groups = {aspect: waterfall.by(aspect) for aspect in ("split", "intent", "object")}
    rows = sum(len(g) + 1.5 for g in groups.values())
    figure = Figure((9, 2.8 + 0.19 * rows), layout="constrained")
    parts = figure.subplots(4, 1, height_ratios=[max(9, 0.28 * rows), *(len(g) + 0.5 for g in groups.values())])
    _draw_steps(parts[0], in_all)
    for axes, (aspect, left_of) in zip(parts[1:], groups.items(), strict=True):
        _draw_shares(axes, aspect, left_of)
    parts[-1].set_xticks(range(len(in_all)), in_all, rotation=20, ha="right", fontsize=8)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=110, metadata={"Software": None})


def _draw_steps(axes, left: dict[str, int]) -> None:
    """Frames left after each rule, beneath them those that it took."""
    names, counts = list(left), np.array(list(left.values()))
    taken = np.concatenate([[0], counts[:-1] - counts[1:]])
    axes.barh(names, counts, color=_BLUE)
    axes.barh(names, taken, left=counts, color=_RED, alpha=0.75)
    for k, (kept, lost) in enumerate(zip(counts, taken, strict=True)):
        text = f" {kept:,}" + (f"  (−{lost:,})" if lost else "")
        axes.text(kept + lost, k, text, va="center", fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.22 * max(counts[0], 1))
    axes.set_title("Frames left by each rule (red: taken away)", fontsize=10, loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)


def _draw_shares(axes, aspect: str, groups: dict[tuple[str, ...], dict[str, int]]) -> None:
    counts = np.array([list(left.values()) for left in groups.values()], float)
    shares = counts / np.maximum(counts[:, :1], 1)
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for row, column in np.ndindex(*shares.shape):
        text = f"{int(counts[row, 0]):,}" if column == 0 else f"{100 * shares[row, column]:.0f} %"
        dark = shares[row, column] > 0.6
        axes.text(column, row, text, ha="center", va="center", fontsize=7, color="white" if dark else "#333333")
    axes.set_yticks(range(len(groups)), [group[0] for group in groups], fontsize=8)
    axes.set_xticks([])
    axes.set_title(f"Share left, by {aspect}", fontsize=10, loc="left")


def draw_contact(hand: HandModel, contact: Tensor, path: Path) -> None:
    """The flat hand, coloured by how often each vertex touches in training frames; nothing where no picture can be
    drawn."""
    if can_render():
        return
    likelihood = (contact / contact.max().clamp_min(1e-12)).numpy()
    colors = colormaps["turbo"](0.08 + 0.84 * likelihood)[:, :3]
    flat = HandParameters(torch.eye(3)[None], torch.eye(3).expand(1, 15, 3, 3), torch.zeros(1, 3))
    shape = Shape(hand(flat).vertices[0], hand.faces, colors)
    tiles = [render([shape], *view, size=(360, 420)) for view in _VIEWS.values()]
    save_image(path, contact_sheet(tiles, [f"{name} (most often: {contact.max():.0%})" for name in _VIEWS], columns=3))
