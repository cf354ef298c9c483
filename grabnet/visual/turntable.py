"""Meshes that turn once about their vertical, drawn fast: the light is painted on them once, not in each frame.

Without a graphics card a frame's time goes into lighting its pixels. Lights that stand still with the scene, and
surfaces that do not shine, give each vertex one colour for all frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np

from grabnet.cli.checks import Range, in_range
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.visual.pictures import Shape

if TYPE_CHECKING:
    import pyvista

_BACKGROUND = (0.965, 0.97, 0.975)
_AMBIENT = 0.42
# From where (not of length 1) and how strong: from above, and a stronger and a weaker one from either side.
_LIGHTS = (((0.0, 0.0, 1.0), 0.34), ((1.0, 0.4, 0.5), 0.42), ((-0.9, -0.7, 0.3), 0.26), ((-0.3, 0.9, -0.5), 0.16))
_FEATURE_ANGLE = 60  # degrees between faces whose edge stays sharp


@dataclass(frozen=True)
class FilmConfig:
    """How a scene that turns once is drawn and encoded.

    size: pixels of the square picture.
    seconds: of one turn.
    fps: frames per second.
    elevation: degrees by which the camera stands above the horizontal.
    view_angle: degrees that the camera sees from edge to edge.
    margin: share of the picture that stays free at each edge.
    supersampling: drawn so many times larger and scaled down, which smooths edges.
    faces: of an object as it is drawn, at most.
    quality: x264's constant rate factor, 0 best … 51 worst.

    Raises:
        UserError: a value out of range.
    """

    size: Annotated[int, Range(64, 4096)]
    seconds: Annotated[float, Range(0.5, 60)]
    fps: Annotated[int, Range(1, 120)]
    elevation: Annotated[float, Range(-80, 80)]
    view_angle: Annotated[float, Range(5, 120)]
    margin: Annotated[float, Range(0, 0.4)]
    supersampling: Annotated[float, Range(1, 4)]
    faces: Annotated[int, Range(100, 10_000_000)]
    quality: Annotated[int, Range(0, 51)]

    def __post_init__(self):
        in_range(self, "film.")
        if self.size % 2:
            raise UserError(f"film.size is {self.size}; it must be even, as H.264 halves the resolution of colours.")
        if self.frames < 2:
            raise UserError(f"film.seconds={self.seconds} at film.fps={self.fps} is no film: raise either.")

    @property
    def frames(self) -> int:
        """Frames of one turn."""
        return round(self.seconds * self.fps)

    @property
    def drawn_size(self) -> int:
        """Pixels as drawn."""
        return round(self.size * self.supersampling)

    def cameras(self) -> np.ndarray:
        """(frames, 3) directions of length 1 from what is filmed to the camera."""
        turn = 2 * math.pi * np.arange(self.frames) / self.frames
        rise = math.radians(self.elevation)
        level = math.cos(rise)
        return np.stack([level * np.sin(turn), -level * np.cos(turn), np.full(self.frames, math.sin(rise))], 1)

    def distance(self, points: np.ndarray, centre: np.ndarray) -> float:
        """The least distance from centre (3,) to the camera at which points (N, 3) stay in view in all frames."""
        tangent = (1 - 2 * self.margin) * math.tan(math.radians(self.view_angle) / 2)
        least = 0.0
        for back in self.cameras():
            right = np.cross((0.0, 0.0, 1.0), back)
            right /= np.linalg.norm(right)
            axes = np.stack([right, np.cross(back, right), back])
            x, y, towards = axes @ (np.asarray(points, float) - centre).T
            least = max(least, float((np.maximum(abs(x), abs(y)) / tangent + towards).max()))
        return least


class Turntable:
    """One window, in which scenes are drawn one after the other."""

    def __init__(self, config: FilmConfig):
        import pyvista
        from vtkmodules.vtkCommonCore import vtkLogger, vtkUnsignedCharArray

        vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # it complains about the missing screen
        self.config = config
        self._stage = pyvista.Plotter(off_screen=True, window_size=(config.drawn_size,) * 2, lighting="none")
        self._stage.ren_win.SetMultiSamples(0)  # supersampling is several times cheaper here
        self._stage.set_background(_BACKGROUND)
        self._stage.camera.view_angle = config.view_angle
        self._stage.camera.up = (0.0, 0.0, 1.0)
        self._pixels = vtkUnsignedCharArray()
        self._frame = np.empty((config.drawn_size, config.drawn_size, 4), np.uint8)

    def frames(self, shapes: Sequence[Shape], centre: np.ndarray, distance: float) -> Iterator[np.ndarray]:
        """Draw one turn.

        Args:
            shapes: in one frame, z up; each of one colour.
            centre: (3,) that the camera looks at.
            distance: of the camera from it.

        Yields:
            uint8 (drawn_size, drawn_size, 4), RGBA: one array, which the next frame overwrites.
        """
        stage = self._stage
        stage.clear_actors()
        for shape in shapes:
            actor = stage.add_mesh(painted(shape), scalars="painted", rgb=True, lighting=False, render=False)
            if _hides_its_back(shape):
                actor.prop.culling = "back"
        stage.camera.focal_point = centre
        for direction in self.config.cameras():
            stage.camera.position = np.asarray(centre, float) + distance * direction
            stage.renderer.ResetCameraClippingRange()
            yield self._drawn()

    def _drawn(self) -> np.ndarray:
        """The stage as it is now, read as it lies in memory: a screenshot takes three times as long."""
        from vtkmodules.util.numpy_support import vtk_to_numpy

        last, window = self.config.drawn_size - 1, self._stage.ren_win
        window.Render()
        window.GetRGBACharPixelData(0, 0, last, last, 0, self._pixels)
        self._frame[:] = vtk_to_numpy(self._pixels).reshape(self._frame.shape)[::-1]  # from the lowest line up
        return self._frame


def _hides_its_back(shape: Shape) -> bool:
    """Whether the inner sides of a shape's faces are never seen, so that they need not be drawn."""
    mesh = Mesh(np.asarray(shape.vertices, np.float32), np.asarray(shape.faces))
    return mesh.is_closed and mesh.volume > 0


def painted(shape: Shape) -> pyvista.PolyData:
    """A shape with the light on it as colours of its vertices, which are split along sharp edges."""
    import pyvista

    solid = pyvista.PolyData.from_regular_faces(np.asarray(shape.vertices, np.float32), np.asarray(shape.faces))
    solid = solid.compute_normals(
        cell_normals=False, split_vertices=True, feature_angle=_FEATURE_ANGLE, consistent_normals=False
    )
    normals, light = np.asarray(solid["Normals"], float), np.full(solid.n_points, _AMBIENT)
    for direction, strength in _LIGHTS:
        towards = np.array(direction) / np.linalg.norm(direction)
        light += strength * (normals @ towards).clip(0)
    solid["painted"] = (255 * np.outer(light, np.asarray(shape.color, float)).clip(0, 1)).astype(np.uint8)
    return solid


def thinned(shape: Shape, faces: int) -> Shape:
    """A shape of at most about so many faces, by quadric decimation; as it is where it has no more."""
    import pyvista

    solid = pyvista.PolyData.from_regular_faces(np.asarray(shape.vertices, np.float32), np.asarray(shape.faces))
    if solid.n_cells <= faces:
        return shape
    solid = solid.decimate(1 - faces / solid.n_cells)
    return shape._replace(vertices=np.asarray(solid.points), faces=solid.regular_faces)
