import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from PIL import Image

from grabnet.visual import pictures
from grabnet.visual.pictures import Shape, can_render, contact_sheet, render, save_image

drawing = pytest.mark.skipif(can_render() is not None, reason=str(can_render()))


def ball(centre, radius=0.03, color=(0.6, 0.6, 0.6)) -> Shape:
    sphere = trimesh.creation.icosphere(4, radius)
    return Shape(sphere.vertices + np.asarray(centre), sphere.faces, color)


def drawn(image: np.ndarray) -> np.ndarray:
    return (image < 250).any(-1)


@drawing
def test_a_ball_covers_its_disc():
    image = render([ball((5.0, -2.0, 1.0))], size=(300, 300))
    assert image.shape == (300, 300, 3)
    # Framed at scale .53 half heights: the radius is 300 · .5 / 1.06 pixels.
    radius = 150 / 1.06
    ys, xs = np.nonzero(drawn(image))
    assert abs(drawn(image).sum() / (np.pi * radius**2) - 1) < 0.02
    assert abs(xs.mean() - 149.5) < 1
    assert abs(ys.mean() - 149.5) < 1


@drawing
@pytest.mark.parametrize(
    ("direction", "first", "second"),
    [((0, -1, 0), "left", "right"), ((0, 1, 0), "right", "left"), ((0.3, -1, 0.2), "left", "right")],
)
def test_sides_are_where_they_should_be(direction, first, second):
    """Looking along +y with z up, −x is on the left and +z above."""
    red, green = ball((-0.1, 0, -0.1), color=(1, 0, 0)), ball((0.1, 0, 0.1), color=(0, 1, 0))
    image = render([red, green], direction, size=(200, 120)).astype(int)
    place = {}
    for name, channel in (("red", 0), ("green", 1)):
        other = 1 - channel
        ys, xs = np.nonzero(image[..., channel] - image[..., other] > 60)
        place[name] = ("left" if xs.mean() < 100 else "right", ys.mean())
    assert (place["red"][0], place["green"][0]) == (first, second)
    assert place["green"][1] < place["red"][1]


@drawing
def test_the_nearer_shape_hides_the_farther():
    near, far = ball((0, -1, 0), 0.04, (1, 0, 0)), ball((0, 1, 0), 0.03, (0, 1, 0))
    image = render([far, near], (0, -1, 0), size=(100, 100)).astype(int)
    assert not (image[..., 1] - image[..., 0] > 60).any()


@drawing
def test_one_window_serves_many_pictures():
    """Each picture shows its own scene only: not the last one's camera, shapes or size."""
    a, b = ([ball((0, 0, 0))], (0, -1, 0)), ([ball((0, 0, 0)), ball((0.1, 0, 0), 0.01)], (0, 0, 1))
    first = render(*a)
    other = render(*b)
    render(*a, size=(64, 32))
    np.testing.assert_array_equal(render(*a), first)
    np.testing.assert_array_equal(render(*b), other)
    assert (first != other).any()


@drawing
def test_colour_per_vertex_and_zoom():
    shape = ball((0, 0, 0))
    color = np.where(np.asarray(shape.vertices)[:, 2:] > 0, (1.0, 0, 0), (0, 0, 1.0))
    image = render([shape._replace(color=color)], (0, -1, 0), size=(100, 100)).astype(int)
    assert image[25, 50, 0] > image[25, 50, 2] + 60
    assert image[75, 50, 2] > image[75, 50, 0] + 60
    assert drawn(render([shape], size=(100, 100), zoom=0.5)).sum() < 0.3 * drawn(image).sum()


@drawing
@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -2), (1, 2, 3)])
def test_any_direction_draws(direction):
    assert drawn(render([ball((0, 0, 0))], direction, size=(60, 60))).mean() > 0.5


def test_without_opengl_one_sentence_says_so():
    """With EGL's drivers hidden and no display, drawing would crash the process: only the probe may notice."""
    hidden = {k: v for k, v in os.environ.items() if k != "DISPLAY"}
    hidden["__EGL_VENDOR_LIBRARY_FILENAMES"] = "/nonexistent"
    code = "from grabnet.visual.pictures import can_render; print(can_render())"
    done = subprocess.run([sys.executable, "-c", code], env=hidden, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("No pictures are drawn: ")
    assert done.stdout.count("\n") == 1
    assert not done.stderr


def test_contact_sheet_keeps_every_tile_in_order():
    tiles = [np.full((20, 30, 3), 40 * i, np.uint8) for i in range(5)]
    sheet = contact_sheet(tiles, columns=3)
    assert sheet.shape == (40, 90, 3)
    for i, tile in enumerate(tiles):
        y, x = i // 3 * 20, i % 3 * 30
        np.testing.assert_array_equal(sheet[y + 1 : y + 19, x + 1 : x + 29], tile[1:-1, 1:-1])  # within its frame
    assert (sheet[20:, 60:] == 255).all()


def test_captions_stand_below_their_tiles():
    tiles = [np.full((100, 100, 3), 255, np.uint8)] * 2
    blank, written = (contact_sheet(tiles, [text, ""], columns=2) for text in ("", "grasp 3 · 1.2 mm"))
    ys, xs = np.nonzero((blank != written).any(-1))
    assert ys.min() >= 100
    assert xs.max() < 100
    assert len(ys) > 50


def test_saved_image_reads_back(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (7, 9, 3), np.uint8)
    save_image(tmp_path / "deep" / "a b.png", image)
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "deep" / "a b.png")), image)


def test_camera_axes_are_a_right_handed_frame():
    rng = np.random.default_rng(1)
    for direction in rng.normal(size=(50, 3)):
        axes = pictures._camera_axes(direction, (0, 0, 1))
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) > 0
        assert axes[0, 2] == pytest.approx(0, abs=1e-12)  # the horizon is level
