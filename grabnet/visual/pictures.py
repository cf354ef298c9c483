"""Pictures of meshes without a screen (VTK through pyvista), and contact sheets of them.

VTK aborts the process where there is no OpenGL, so ask `can_render()` first.
"""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont

from grabnet.io.files import replacing

if TYPE_CHECKING:
    import pyvista

SKIN = (0.93, 0.73, 0.62)
OBJECT = (0.58, 0.67, 0.77)

# Draws one empty frame: exits with 0 only where VTK finds an OpenGL to draw with.
_PROBE = """
from vtkmodules.vtkCommonCore import vtkLogger
vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
import vtkmodules.vtkRenderingOpenGL2
from vtkmodules.vtkRenderingCore import vtkRenderer, vtkRenderWindow
window = vtkRenderWindow()
window.SetOffScreenRendering(1)
window.AddRenderer(vtkRenderer())
window.Render()
raise SystemExit(0 if window.SupportsOpenGL() else 1)
"""


class Shape(NamedTuple):
    """A mesh to draw: vertices (V, 3) and triangles (F, 3), arrays or CPU tensors.

    color: a name, an RGB triple in [0, 1], or (V, 3) of them, one per vertex. opacity: 0 clear … 1 solid.
    """

    vertices: ArrayLike
    faces: ArrayLike
    color: str | Sequence[float] | np.ndarray = OBJECT
    opacity: float = 1.0


@cache
def can_render() -> str | None:
    """None where pictures can be drawn, otherwise one sentence saying why not; found out once, in 0.4 s."""
    try:
        probe = subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, timeout=60, check=False)
    except subprocess.TimeoutExpired:
        return "No pictures are drawn: VTK did not draw a test frame within 60 s."
    if probe.returncode == 0:
        return None
    said = probe.stderr.decode(errors="replace").strip().splitlines()
    reason = f" ({said[-1].strip()})" if said else ""
    return f"No pictures are drawn: VTK finds no OpenGL on this machine{reason}; install Mesa (libegl1) to have them."


def render(
    shapes: Sequence[Shape],
    direction: Sequence[float] = (-0.45, -1.0, 0.45),
    up: Sequence[float] = (0.0, 0.0, 1.0),
    size: tuple[int, int] = (400, 400),
    zoom: float = 1.0,
    around: np.ndarray | None = None,
) -> np.ndarray:
    """Draw the shapes in parallel projection, framed to fill the picture.

    Args:
        shapes: in one common frame and unit.
        direction: from the scene towards the viewer.
        up: what points upwards in the picture; any other vector is taken when it is parallel to `direction`.
        size: (width, height) in pixels.
        zoom: above 1 closer than the frame.
        around: (N, 3) points that the frame is put around, the same in all pictures of a film; the shapes' if omitted.

    Returns:
        uint8 (height, width, 3), white where there is nothing.
    """
    return render_views(shapes, [direction], up, size, zoom, around)[0]


def render_views(
    shapes: Sequence[Shape],
    directions: Sequence[Sequence[float]],
    up: Sequence[float] = (0.0, 0.0, 1.0),
    size: tuple[int, int] = (400, 400),
    zoom: float = 1.0,
    around: np.ndarray | None = None,
) -> list[np.ndarray]:
    """`render` from several directions, for little more than the time of one."""
    stage = _stage(size)
    stage.clear_actors()
    for shape in shapes:
        _add(stage, shape)
    points = np.concatenate([np.asarray(shape.vertices, np.float32) for shape in shapes]) if around is None else around
    return [_draw(stage, points, _camera_axes(direction, up), zoom) for direction in directions]


def contact_sheet(
    tiles: Sequence[np.ndarray], captions: Sequence[str] | None = None, columns: int | None = None
) -> np.ndarray:
    """Tiles of equal size side by side, row by row, each above its caption; about as wide as high by default.

    Args:
        tiles: uint8 (H, W, 3) each.
        captions: one per tile, one line of text each.

    Returns:
        uint8 image (H', W', 3).
    """
    height, width = tiles[0].shape[:2]
    font = ImageFont.load_default(size=max(10, height // 26))
    strip = 0 if captions is None else 2 * int(font.size)
    columns = min(columns or math.ceil(math.sqrt(len(tiles) * (height + strip) / width)), len(tiles))
    rows = math.ceil(len(tiles) / columns)
    sheet = Image.new("RGB", (columns * width, rows * (height + strip)), "white")
    draw = ImageDraw.Draw(sheet)
    for i, tile in enumerate(tiles):
        x, y = i % columns * width, i // columns * (height + strip)
        sheet.paste(Image.fromarray(tile), (x, y))
        draw.rectangle((x, y, x + width - 1, y + height + strip - 1), outline="#e6eaee")
        if captions is not None:
            draw.text((x + width / 2, y + height + strip / 2), captions[i], "#333333", font, anchor="mm")
    return np.asarray(sheet)


def save_image(path: str | Path, image: np.ndarray) -> None:
    """Write a uint8 (H, W, 3) image, atomically; the suffix chooses the format."""
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary)


def _add(stage: pyvista.Plotter, shape: Shape) -> None:
    import pyvista

    color = shape.color if isinstance(shape.color, str) else np.asarray(shape.color, float)  # integers mean 0…255
    per_vertex = np.ndim(color) == 2
    stage.add_mesh(
        pyvista.PolyData.from_regular_faces(np.asarray(shape.vertices, np.float32), np.asarray(shape.faces)),
        opacity=shape.opacity,
        smooth_shading=True,
        split_sharp_edges=not per_vertex,  # splitting would part the vertices from their colours
        feature_angle=60,
        ambient=0.12,
        specular=0.12,
        specular_power=12,
        render=False,
        **({"scalars": color, "rgb": True} if per_vertex else {"color": color}),
    )


def _draw(stage: pyvista.Plotter, points: np.ndarray, view: np.ndarray, zoom: float) -> np.ndarray:
    """What the stage holds, framed around `points` (N, 3) as seen along the axes `view`."""
    spread = points @ view.T
    low, high = spread.min(0), spread.max(0)
    centre, (width, height, depth) = (low + high) / 2 @ view, high - low
    aspect = stage.window_size[0] / stage.window_size[1]
    scale = max(width / aspect, height, 1e-9)  # one point alone still needs some frame
    stage.camera.position = centre + view[2] * (depth + 2 * scale)
    stage.camera.focal_point, stage.camera.up = centre, view[1]
    stage.camera.parallel_scale = 0.53 * scale / zoom
    stage.renderer.ResetCameraClippingRange()
    stage.render()  # otherwise the screenshot is the frame before
    return np.array(stage.screenshot(return_img=True))


def _camera_axes(direction: Sequence[float], up: Sequence[float]) -> np.ndarray:
    """Rows: the picture's right, its up and the way to the viewer, orthonormal."""
    back = np.asarray(direction, float) / np.linalg.norm(direction)
    right = np.cross(up, back)
    if np.linalg.norm(right) < 1e-6:
        right = np.cross(np.roll(up, 1), back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back])


@cache
def _stage(size: tuple[int, int]) -> pyvista.Plotter:
    """The one window of this size; making it costs more than drawing in it."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkLogger

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # it complains about the missing screen, then does without
    stage = pyvista.Plotter(off_screen=True, window_size=size, lighting="none")
    stage.set_background("white")
    stage.enable_anti_aliasing("msaa", multi_samples=8)
    stage.enable_parallel_projection()
    for position, intensity in (((-0.5, 0.8, 1.0), 0.75), ((1.0, -0.2, 0.6), 0.3), ((0.0, 0.1, 1.0), 0.25)):
        stage.add_light(pyvista.Light(position=position, light_type="camera light", intensity=intensity))
    return stage
