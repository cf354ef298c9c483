"""The page in a real browser: it shows the grasps, turns them, and fetches nothing."""

import re

import numpy as np
import pytest
import trimesh

from grabnet.generation.captions import caption
from grabnet.generation.viewer import write_viewer
from grabnet.geometry.mesh import Mesh

from .browser import EXECUTABLE, Browser

TITLE = 'tässe </script><b id="x">&amp;'


@pytest.fixture(scope="module")
def grasps(grabber, cache_dir):
    box = trimesh.creation.box((0.05, 0.07, 0.06)).subdivide().subdivide()
    return grabber(Mesh(box.vertices + np.array([0.3, -0.2, 0.1]), box.faces), 5, seed=2, cache_dir=cache_dir)


@pytest.fixture(scope="module")
def page(grasps, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "index.html"
    write_viewer(path, grasps, TITLE)
    return path


@pytest.fixture(scope="module")
def browser(page, tmp_path_factory):
    if EXECUTABLE is None:
        pytest.skip("there is no Chromium to look at the page with")
    with Browser(tmp_path_factory.mktemp("profile")) as browser:
        browser.open(page)
        yield browser


def view(browser: Browser) -> np.ndarray:
    """The pixels of the 3-D view without what is written over it."""
    return browser.screenshot()[260:520, 260:690]


def test_the_page_is_one_file(page):
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"""(?:src|href)\s*=|url\(|@import|https?://|\bfetch\(|XMLHttpRequest|import\s*\(""", text)
    assert "default-src 'none'" in text


def test_nothing_goes_wrong_and_nothing_is_fetched(browser, page):
    browser.wait("document.querySelectorAll('#list button').length === 5")
    assert browser.log["exceptions"] == []
    assert browser.log["console"] == []
    assert browser.log["requests"] == [page.resolve().as_uri()]


def test_title_and_measurements_are_those_of_the_grasps(browser, grasps):
    assert browser.evaluate("document.getElementById('title').textContent") == TITLE
    assert browser.evaluate("document.getElementById('x')") is None
    browser.evaluate("show(1)")
    facts = browser.evaluate("document.getElementById('facts').innerText")
    record = grasps.report()[1]
    assert "grasp 1 (of 0 to 4, as in the files)" in facts  # counted as in meshes/grasp_001.glb and grasps.json
    buttons = browser.evaluate("[...document.querySelectorAll('#list button')].map(b => b.textContent)")
    depth = ["goes through" if r["pierced"] else f"{r['max_penetration_mm']:.1f} mm deep" for r in grasps.report()]
    assert buttons == [f"{i}: {words}" for i, words in enumerate(depth)]
    assert f"{record['max_penetration_mm']:.1f} mm" in facts
    assert f"{record['through_mm']:.1f} mm" in facts
    assert caption(record) in facts
    assert re.search(rf"goes through\s+{'yes' if record['pierced'] else 'no'}", facts)
    for part, count in record["contact_vertices"].items():
        assert re.search(rf"{part}\s+{f'{count} in contact' if count else '–'}", facts)


def test_geometry_survives_its_encoding(browser, grasps):
    shown = np.array(browser.evaluate("Array.from(handVertices)")).reshape(5, -1, 3)
    np.testing.assert_allclose(shown, grasps.vertices.numpy(), atol=1e-5)
    solid = np.array(browser.evaluate("Array.from(object.vertices)")).reshape(-1, 3)
    np.testing.assert_allclose(solid, grasps.mesh.vertices, atol=1e-5)
    faces = np.array(browser.evaluate("Array.from(handFaces)")).reshape(-1, 3)
    np.testing.assert_array_equal(faces, grasps.faces.numpy())
    touching = np.array(browser.evaluate("Array.from(touching)")).reshape(5, -1)
    assert touching.astype(bool).sum() == grasps.contacts.contact_vertices.sum()


def test_the_view_is_drawn_and_turns(browser):
    before = view(browser)
    assert before.std() > 20
    browser.drag((450, 400), (560, 430))
    turned = view(browser)
    assert (abs(turned - before).max(-1) > 30).mean() > 0.05
    browser.drag((560, 430), (450, 400))
    assert (abs(view(browser) - before).max(-1) > 30).mean() < 0.01  # there and back


def test_dragging_carries_the_near_side_along(browser):
    """A point on the viewer's side moves with the mouse: right by a drag to the right, down by one down."""
    project = """(() => { const [right, up, back] = eye();
                          const near = along([0, 0, 0], frame.radius, window.near ??= back);
                          return [dot(near, right), dot(near, up)]; })()"""
    browser.evaluate("window.near = undefined")
    x, y = browser.evaluate(project)
    assert (x, y) == (pytest.approx(0, abs=1e-9), pytest.approx(0, abs=1e-9))
    browser.drag((450, 400), (470, 420))
    x, y = browser.evaluate(project)
    assert x > 0.001
    assert y < -0.001


def test_stepping_and_switches_change_the_view(browser):
    browser.evaluate("show(0)")
    first = view(browser)
    browser.press("ArrowRight")
    assert browser.evaluate("current") == 1
    second = view(browser)
    assert (second != first).any()
    browser.evaluate("document.getElementById('previous').click()")
    assert browser.evaluate("current") == 0
    np.testing.assert_array_equal(view(browser), first)
    browser.press("ArrowLeft")
    assert browser.evaluate("current") == 4  # round the corner
    browser.evaluate("document.querySelectorAll('#list button')[0].click()")
    for switch in ("contacts", "ghost"):
        browser.evaluate(f"document.getElementById('{switch}').click()")
        changed = view(browser)
        assert (abs(changed - first).max(-1) > 10).any(), switch
        browser.evaluate(f"document.getElementById('{switch}').click()")


def test_wheel_zooms(browser):
    def covered() -> float:
        return float((view(browser).max(-1) - view(browser).min(-1) > 25).mean())  # colour: hand or object

    before = covered()
    browser.mouse("mouseWheel", (450, 400), deltaX=0, deltaY=-300)
    assert covered() > 1.1 * before


def test_thumbnails_are_drawn(browser):
    browser.wait(
        "document.querySelector('#list canvas').getContext('2d').getImageData(0, 0, 128, 128).data.some(x => x)"
    )
    drawn = """[...document.querySelectorAll('#list canvas')].map(c =>
               c.getContext('2d').getImageData(0, 0, 128, 128).data.filter((x, i) => i % 4 === 3 && x).length)"""
    assert min(browser.evaluate(drawn)) > 500


def test_contact_colours_are_explained(browser):
    legend = """[...document.querySelectorAll('#legend span')].map(
                s => [getComputedStyle(s.querySelector('i')).backgroundColor, s.textContent])"""
    assert browser.evaluate(legend) == [
        ["rgb(237, 107, 56)", "touching: within 4.5 mm of the object"],
        ["rgb(158, 41, 107)", "inside the object"],
    ]
    browser.evaluate("document.getElementById('contacts').click()")
    assert browser.evaluate(legend) == []  # nothing is coloured
    browser.evaluate("document.getElementById('contacts').click()")


@pytest.mark.parametrize("size", [(390, 844), (844, 390), (360, 640), (900, 600)])
def test_nothing_covers_the_scene(browser, size):
    """Phones upright and on their side, too: what is written stands beside the scene, which has most of the room."""
    try:
        browser.call(
            "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=True
        )
        browser.wait(f"innerWidth === {size[0]} && innerHeight === {size[1]}")
        boxes = browser.evaluate(
            """Object.fromEntries(["view", "facts", "list", "help"].map(id => {
               const r = document.getElementById(id).getBoundingClientRect();
               return [id, [r.left, r.top, r.right, r.bottom]]; }))"""
        )
        left, top, right, bottom = boxes["view"]
        assert (right - left) * (bottom - top) > 0.29 * size[0] * size[1]
        for name in ("facts", "list"):
            a, b, c, d = boxes[name]
            assert min(right, c) <= max(left, a) + 1 or min(bottom, d) <= max(top, b) + 1, name
            assert c - a > 50 and d - b > 50
        for a, b, c, d in boxes.values():
            assert 0 <= a <= c <= size[0] and 0 <= b <= d <= size[1]
        assert boxes["help"] == [0, 0, 0, 0] or size == (900, 600)
        fits = "['facts', 'stage'].map(id => document.getElementById(id)).every(e => e.scrollWidth <= e.clientWidth)"
        assert browser.evaluate(fits)
    finally:
        browser.call("Emulation.setDeviceMetricsOverride", width=900, height=600, deviceScaleFactor=1, mobile=False)
        browser.wait("innerWidth === 900")
