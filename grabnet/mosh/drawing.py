"""Pictures of how well a recording fits its markers: residuals over time, and a film of body, markers and residuals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
import trimesh
from matplotlib.figure import Figure
from PIL import Image

from grabnet.body.whole import BodyModel
from grabnet.data.sequences import Sequence, load_below, read_sequence
from grabnet.io.files import replacing
from grabnet.mosh.assembling import NO_OBJECT
from grabnet.mosh.attachment import Attachment, Pose
from grabnet.mosh.capture_work import read_report, report_path
from grabnet.mosh.layouts import Layout
from grabnet.mosh.markers import MarkerData
from grabnet.mosh.placing import TYPE_COLORS, balls
from grabnet.mosh.quality import marker_residuals
from grabnet.visual.pictures import OBJECT, SKIN, Shape, can_render, render

_FRAMES_PER_SECOND, _MOST_FRAMES = 15, 120
_VIEW = (1.0, -0.7, 0.45)
_WORST = 0.01  # metres: residuals of this length and more are drawn red


def draw_quality(
    root: Path, name: str, markers: MarkerData, layout: Layout, latent: torch.Tensor, body: BodyModel
) -> str | None:
    """Draw a solved recording: `<name>.png`, residuals over time, and `<name>.webp`, the film, beside its report.

    Args:
        root: of the data set.
        name: of the recording.
        markers: the subject's.
        layout: of them.
        latent: (M, 3) where they sit.
        body: the model.

    Returns:
        why there is no film; None where there is one.
    """
    sequence = read_sequence(root / "grab" / f"{name}.npz")
    v_template = torch.tensor(load_below(root, sequence.body.vtemp).vertices)
    attachment = Attachment(body, v_template, layout, latent)
    parameters = sequence.body.parameters()
    pose = Pose(parameters.rotations, parameters.transl, torch.zeros(len(sequence), 0))
    observed = markers.pick(layout.labels).positions
    residuals, model = marker_residuals(attachment, pose, observed)
    report = report_path(root, name)
    _plot(report.with_suffix(".png"), residuals, layout, sequence.framerate, read_report(root, name))
    if reason := can_render():
        return reason
    _film(report.with_suffix(".webp"), root, sequence, body, v_template, observed, model, residuals)
    return None


def _plot(path: Path, residuals: np.ndarray, layout: Layout, rate: float, report: dict) -> None:
    seconds, missing = np.arange(len(residuals)) / rate, np.isnan(residuals)
    figure = Figure((10, 6), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    for type_, color in TYPE_COLORS.items():
        those = layout.types == type_
        if those.any():
            values = 1e3 * residuals[:, those]
            mean = np.nansum(values, 1) / np.maximum(1, np.isfinite(values).sum(1))
            top.plot(seconds, mean, color=color, label=f"{type_} ({those.sum()} markers)", linewidth=0.8)
    top.set_ylabel("mean distance of markers, mm")
    top.legend(loc="upper right")
    bottom.fill_between(seconds, 100 * missing.mean(1), color="0.7")
    bottom.set_ylabel("missing, %")
    bottom.set_xlabel("seconds")
    for reason, frames in report["body"]["flagged"].items():
        if frames:
            bottom.plot(np.array(frames) / rate, np.zeros(len(frames)), "|", label=reason)
    if bottom.get_legend_handles_labels()[0]:
        bottom.legend(loc="upper right", fontsize="small")
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=100, metadata={"Software": None})


def _film(
    path: Path,
    root: Path,
    sequence: Sequence,
    body: BodyModel,
    v_template: torch.Tensor,
    observed: np.ndarray,
    model: np.ndarray,
    residuals: np.ndarray,
) -> None:
    every = max(round(sequence.framerate / _FRAMES_PER_SECOND), -(-len(sequence) // _MOST_FRAMES))
    frames = np.arange(0, len(sequence), every)
    thing = None
    if sequence.obj_name != NO_OBJECT:
        mesh = load_below(root, sequence.object.mesh)
        thing = sequence.object.to_world(torch.tensor(mesh.vertices), frames).numpy(), mesh.faces
    pictures = []
    for k, frame in enumerate(frames):
        with torch.no_grad():
            skin = body(sequence.body.parameters(np.array([frame])), v_template).vertices[0].numpy()
        shapes = [Shape(skin, body.faces.numpy(), SKIN, 0.55), _seen(observed[frame], residuals[frame])]
        shapes += _sticks(observed[frame], model[frame])
        if thing is not None:
            shapes.append(Shape(thing[0][k], thing[1], OBJECT))
        pictures.append(Image.fromarray(render(shapes, _VIEW, size=(420, 480))))
    with replacing(path) as temporary:
        first, *others = pictures
        duration = round(1000 * every / sequence.framerate)
        first.save(temporary, save_all=True, append_images=others, duration=duration, loop=0)


def _seen(places: np.ndarray, residuals: np.ndarray) -> Shape:
    """Balls at the markers that are seen, from green to red by their residuals."""
    seen = np.isfinite(residuals).nonzero()[0]
    bad = np.clip(residuals[seen] / _WORST, 0, 1)[:, None]
    return balls(places[seen], np.full(len(seen), 0.007), (1 - bad) * [0.1, 0.6, 0.2] + bad * [0.9, 0.1, 0.1])


def _sticks(observed: np.ndarray, model: np.ndarray) -> list[Shape]:
    """Lines from markers to where the body has them, where these are far enough apart to be seen."""
    far = (np.linalg.norm(observed - model, axis=-1) > 0.005).nonzero()[0]
    sticks = [trimesh.creation.cylinder(0.002, segment=[observed[k], model[k]], sections=6) for k in far]
    if not sticks:
        return []
    whole = trimesh.util.concatenate(sticks)
    return [Shape(whole.vertices, whole.faces, (0.9, 0.1, 0.1))]
