"""The exported page in a headless Chromium, against the real server: from the first page to the stored answer."""

from __future__ import annotations

import json
import time

import pytest

from grabnet.study.key import StudyKey
from tests.generation.browser import EXECUTABLE, Browser
from tests.study.conftest import served

pytestmark = pytest.mark.skipif(EXECUTABLE is None, reason="no Chromium is installed")

OPEN = "document.querySelector('.levels button:enabled')"
SHOWN = "document.querySelector('.levels')"
# Keeps a page from hearing that a video has ended, until it is let go.
HOLD = """
window.hold = true;
window.addEventListener("ended", (event) => {
  if (window.hold) { event.stopImmediatePropagation(); event.target.dataset.held = "1"; }
}, true);
"""
IDS = "?PROLIFIC_PID=5f1a&STUDY_ID=6e&SESSION_ID=7d-_&email=a%40b.c"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile"), size=(900, 800)) as browser:
        yield browser
        assert browser.log["exceptions"] == []
        assert browser.log["console"] == []  # no breach of the security policy, nothing that did not load


def visit(browser: Browser, address: str) -> None:
    browser.call("Page.navigate", url=address)
    for _ in range(400):  # the page that is left may still answer, and end while it does
        try:
            if browser.evaluate("document.readyState === 'complete' && !!document.querySelector('.jspsych-content')"):
                return
        except RuntimeError:
            pass
        time.sleep(0.05)
    raise AssertionError("the page did not load")


def state(browser: Browser) -> dict:
    (value,) = json.loads(browser.evaluate("JSON.stringify(Object.values(localStorage))"))
    return json.loads(value)


def begin(browser: Browser) -> None:
    """Through consent and instructions by keyboard, as far as a button needs no pointer."""
    for name in ("I agree", "Begin"):
        browser.wait(f"(document.querySelector('.jspsych-btn') || {{}}).textContent === '{name}'")
        browser.evaluate("document.querySelector('.jspsych-btn').focus()")
        enter(browser)
    browser.wait(SHOWN)


def enter(browser: Browser) -> None:
    key = {"key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13, "text": "\r"}
    browser.call("Input.dispatchKeyEvent", type="keyDown", **key)
    browser.call("Input.dispatchKeyEvent", type="keyUp", **key)


def answer(browser: Browser, number: int, total: int, key: str) -> None:
    browser.wait(f"{OPEN} && document.querySelector('.progress').textContent === '{what(browser)} {number} of {total}'")
    browser.press(key)


def what(browser: Browser) -> str:
    return "Pair" if browser.evaluate("document.querySelectorAll('figure').length > 1") else "Video"


def lines(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / "private/answers.jsonl").read_text().splitlines()]


def test_a_whole_participation_with_a_reload_half_way(rating_study, copied, browser):
    folder = copied(rating_study)
    key = StudyKey.read(folder)
    script = browser.call("Page.addScriptToEvaluateOnNewDocument", source=HOLD)["identifier"]
    with served(folder) as (address, _):
        visit(browser, f"{address}/{IDS}")
        browser.call("Page.removeScriptToEvaluateOnNewDocument", identifier=script)
        assert "By going on you agree" in browser.evaluate("document.body.textContent")
        begin(browser)
        trials = state(browser)
        assert sorted(map(tuple, trials["order"])) == sorted(map(tuple, key.lists[trials["list"]]))
        # Locked until the video has been seen: neither key nor click counts.
        browser.wait("document.querySelector('video').dataset.held")
        assert browser.evaluate("document.querySelectorAll('.levels button:disabled').length") == 5
        browser.press("5")
        browser.evaluate("document.querySelector('.levels button').click()")
        assert browser.evaluate("document.querySelector('.progress').textContent") == "Video 1 of 3"
        browser.evaluate("window.hold = false; document.querySelector('video').play()")
        answer(browser, 1, 3, "4")
        browser.wait("document.querySelector('.progress').textContent === 'Video 2 of 3'")
        assert len(state(browser)["answers"]) == 1
        visit(browser, f"{address}/{IDS}")
        browser.wait(SHOWN)  # neither consent nor instructions again
        assert state(browser) | {"answers": []} == trials | {"answers": []}
        answer(browser, 2, 3, "7")  # no level
        answer(browser, 2, 3, "1")
        browser.wait(f"{OPEN} && document.querySelector('.progress').textContent === 'Video 3 of 3'")
        browser.evaluate("document.querySelectorAll('.levels button')[1].click()")
        browser.wait("document.body.textContent.includes('Your answers are stored')")
        (record,) = lines(folder)
        assert [a["answer"] for a in record["answers"]] == [4, 1, 2]
        assert [a["videos"] for a in record["answers"]] == trials["order"]
        assert all(0.4 < a["seconds"] < 600 for a in record["answers"])
        assert record["platform"] == {"PROLIFIC_PID": "5f1a", "STUDY_ID": "6e", "SESSION_ID": "7d-_"}  # and no address
        visit(browser, f"{address}/{IDS}")
        browser.wait("document.body.textContent.includes('Your answers are stored')")
        assert len(lines(folder)) == 1
    assert {url.split("/")[2] for url in browser.log["requests"] if "//" in url} == {address.split("/")[2]}


def test_a_screen_reader_finds_names_and_states(rating_study, copied, browser):
    folder = copied(rating_study)
    with served(folder) as (address, _):
        visit(browser, address)
        begin(browser)
        browser.wait(OPEN)
        nodes = browser.call("Accessibility.getFullAXTree")["nodes"]
        found = {(n["role"]["value"], n.get("name", {}).get("value", "")) for n in nodes if not n["ignored"]}
        levels = {name for role, name in found if role == "button"}
        assert levels == {
            "1 strongly disagree", "2 disagree", "3 neither agree nor disagree", "4 agree", "5 strongly agree",
        }  # fmt: skip
        assert ("group", "Humans can grasp this object as the video shows") in found
        assert any(role == "Video" and name == "A hand on an object, turning" for role, name in found)
        assert any(role == "progressIndicator" or role == "progressbar" for role, _ in found)
        assert ("main", "") in found and any(role == "status" for role, _ in found)
        assert browser.evaluate("document.activeElement.id") == "statement"
        assert browser.evaluate("document.documentElement.lang") == "en"


def test_a_phone_shows_video_and_all_levels_at_once(rating_study, copied, browser):
    folder = copied(rating_study)
    browser.call("Emulation.setDeviceMetricsOverride", width=375, height=667, deviceScaleFactor=2, mobile=True)
    browser.call("Emulation.setTouchEmulationEnabled", enabled=True)
    try:
        with served(folder) as (address, _):
            visit(browser, address)
            begin(browser)
            for number in (1, 2, 3):
                browser.wait(f"{OPEN} && document.querySelector('.progress').textContent === 'Video {number} of 3'")
                boxes = browser.evaluate(
                    "[...document.querySelectorAll('video, .levels button')].map(e => e.getBoundingClientRect())"
                    ".map(b => [b.left, b.top, b.right, b.bottom])"
                )
                assert len(boxes) == 6 and browser.evaluate("document.documentElement.scrollWidth") <= 375
                for left, top, right, bottom in boxes:
                    assert 0 <= left < right <= 375 and 0 <= top < bottom <= 667
                    assert bottom - top >= 40  # a finger's width
                assert boxes[0][2] - boxes[0][0] == pytest.approx(boxes[0][3] - boxes[0][1], abs=1)
                left, top, right, bottom = boxes[5]
                touch = [{"x": (left + right) / 2, "y": (top + bottom) / 2}]
                browser.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=touch)
                browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
            browser.wait("document.body.textContent.includes('Your answers are stored')")
            assert [a["answer"] for a in lines(folder)[0]["answers"]] == [5, 5, 5]
    finally:
        browser.call("Emulation.setTouchEmulationEnabled", enabled=False)
        browser.call("Emulation.setDeviceMetricsOverride", width=900, height=800, deviceScaleFactor=1, mobile=False)


def test_pairs_and_completion_only_once_the_answers_are_stored(paired_study, copied, browser):
    folder = copied(paired_study)
    key = StudyKey.read(folder)
    path = folder / "private/answers.jsonl"
    completion = "https://app.prolific.com/submissions/complete?cc=C0DE"
    start = len(browser.log["requests"])

    def opened() -> list[str]:
        return [url for url in browser.log["requests"][start:] if "prolific" in url]

    with served(folder) as (address, process):
        visit(browser, f"{address}/?PROLIFIC_PID=a1")
        begin(browser)
        order = state(browser)["order"]
        assert {frozenset(trial) for trial in order} == key.trials[state(browser)["list"]]
        assert len(browser.evaluate("[...document.querySelectorAll('video')].map(v => v.src)")) == 2
        for number in range(1, len(order)):
            answer(browser, number, len(order), "12"[number % 2])
            browser.wait(f"document.querySelector('.progress').textContent.startsWith('Pair {number + 1} ')")
        browser.wait(OPEN)
        process.kill()  # the server is gone when the answers are sent
        process.wait()
        browser.press("1")
        browser.wait("document.body.textContent.includes('could not be sent')")
        assert opened() == [] and path.read_bytes() == b""
        assert browser.evaluate("[...document.querySelectorAll('button')].map(b => b.textContent)") == [
            "Send again", "Download",
        ]  # fmt: skip
        port = address.rpartition(":")[2]
    with served(folder, f"port={port}") as (address, _):
        # What a rater would send by hand: the same record.
        browser.evaluate(
            "window.saved = null; URL.createObjectURL = (blob) => (blob.text().then(t => window.saved = t), '#')"
        )
        browser.evaluate("document.querySelectorAll('button')[1].click()")
        browser.wait("window.saved")
        downloaded = json.loads(browser.evaluate("window.saved"))
        browser.evaluate("document.querySelectorAll('button')[0].click()")
        for _ in range(200):
            if path.read_bytes() and opened():
                break
            time.sleep(0.05)
            browser.call("Page.enable")  # takes in what the browser reports
    assert opened() == [completion] and lines(folder) == [downloaded]
    assert [a["videos"] for a in downloaded["answers"]] == order
    browser.log["console"].clear()  # that the server was gone, and that there is no network
