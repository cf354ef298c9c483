"""The videos of a study: one film and one poster for each grasp, made in parallel and only where they are not there."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from PIL import Image
from scipy.spatial import ConvexHull

from grabnet.cli.progress import track
from grabnet.errors import UserError
from grabnet.geometry.mesh import Mesh
from grabnet.visual.h264 import required_av, write_video
from grabnet.visual.pictures import OBJECT, SKIN, Shape, can_render, save_image
from grabnet.visual.turntable import FilmConfig, Turntable, thinned

VIDEOS, POSTERS = "videos", "posters"


@dataclass(frozen=True, eq=False)
class Scene:
    """A grasp to film.

    name: of its files, without suffix.
    vertices: (V, 3) and faces (F, 3) of the closed hand, in the frame of the object's mesh, metres.
    object: its name.
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    object: str


@dataclass(frozen=True, eq=False)
class Set:
    """What all films of one object share.

    solid: the object, as it is drawn.
    corners: (N, 3) of its convex hull.
    distance: of the camera from what it turns about, so that no hand leaves the picture.
    """

    solid: Shape
    corners: np.ndarray
    distance: float

    @classmethod
    def of(cls, mesh: Mesh, hands: Sequence[np.ndarray], config: FilmConfig) -> Set:
        """The set in which each of the hands (V, 3) stays in view all the way round."""
        solid = thinned(Shape(mesh.vertices, mesh.faces, OBJECT), config.faces)
        corners = mesh.vertices[ConvexHull(mesh.vertices).vertices]
        distance = max(config.distance(np.concatenate([corners, hand]), _middle(corners, hand)) for hand in hands)
        return cls(solid, corners, distance)

    def centre(self, hand: np.ndarray) -> np.ndarray:
        """(3,) that the camera turns about where the object is held by a hand (V, 3)."""
        return _middle(self.corners, hand)


def _middle(*parts: np.ndarray) -> np.ndarray:
    """The middle of the box around points (N, 3) each."""
    return (np.min([part.min(0) for part in parts], 0) + np.max([part.max(0) for part in parts], 0)) / 2


def film(scenes: Sequence[Scene], sets: Mapping[str, Set], site: Path, config: FilmConfig, processes: int) -> int:
    """Write the videos and posters that are not there yet, each atomically, and remove those of other scenes.

    Args:
        scenes: of different names.
        sets: by object.
        site: folder in which `videos/` and `posters/` lie.
        config: how they are drawn.
        processes: at once.

    Returns:
        how many videos were made.

    Raises:
        UserError: this machine cannot draw or encode.
    """
    for folder, suffix in ((VIDEOS, ".mp4"), (POSTERS, ".jpg")):
        (site / folder).mkdir(parents=True, exist_ok=True)
        names = {f"{scene.name}{suffix}" for scene in scenes}
        for path in (site / folder).glob(f"*{suffix}"):  # also what a killed process left half-written
            if path.name not in names:
                path.unlink()
    missing = [scene for scene in scenes if not all(path.exists() for path in _files(site, scene.name))]
    if not missing:
        return 0
    required_av()
    if (reason := can_render()) is not None:
        raise UserError(reason)
    pool = Parallel(n_jobs=min(processes, len(missing)), return_as="generator_unordered", batch_size=1)
    jobs = (delayed(_film)(scene, sets[scene.object], site, config) for scene in missing)
    for _ in track(pool(jobs), "Filming grasps", len(missing)):
        pass
    return len(missing)


def _film(scene: Scene, shared: Set, site: Path, config: FilmConfig) -> None:
    video, poster = _files(site, scene.name)
    hand = Shape(scene.vertices, scene.faces, SKIN)
    frames = _turntable(config).frames([shared.solid, hand], shared.centre(scene.vertices), shared.distance)
    first = next(frames)
    picture = Image.fromarray(first[..., :3]).resize((config.size, config.size), Image.Resampling.BOX)
    save_image(poster, np.asarray(picture))
    write_video(video, chain([first], frames), config.size, config.fps, config.quality)
    for path in (video, poster):
        os.utime(path, (0, 0))  # when a file was made would hint at what it shows


@cache
def _turntable(config: FilmConfig) -> Turntable:
    """The one window of this process."""
    os.environ.setdefault("LP_NUM_THREADS", "1")  # of Mesa: each process draws on one core
    return Turntable(config)


def _files(site: Path, name: str) -> tuple[Path, Path]:
    return site / VIDEOS / f"{name}.mp4", site / POSTERS / f"{name}.jpg"
