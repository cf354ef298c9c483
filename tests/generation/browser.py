"""A headless Chromium, driven over a pipe by its DevTools protocol: what a user's browser does with a page."""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
from PIL import Image

EXECUTABLE = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)


class Browser:
    """One tab. `log` gathers console messages, exceptions and the addresses of all requests."""

    def __init__(self, profile: Path, size: tuple[int, int] = (900, 600)):
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        options = (
            f"--headless --no-sandbox --remote-debugging-pipe --user-data-dir={profile} --disable-gpu-sandbox "
            "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-dev-shm-usage "
            f"--no-first-run --disable-background-networking --window-size={size[0]},{size[1]} about:blank"
        )
        # The protocol speaks on descriptors 3 and 4.
        shell = f"exec {EXECUTABLE} {options} 3<&{to_browser} 4>&{from_browser}"
        self._process = subprocess.Popen(
            ["bash", "-c", shell], pass_fds=(to_browser, from_browser), stderr=subprocess.DEVNULL
        )
        os.close(to_browser)
        os.close(from_browser)
        self._buffer = b""
        self._count = 0
        self._session: str | None = None
        self.log: dict[str, list[str]] = {"console": [], "exceptions": [], "requests": []}
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=1, mobile=False
        )

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_) -> None:
        self._process.kill()
        self._process.wait()
        os.close(self._read)
        os.close(self._write)

    def call(self, method: str, **parameters) -> dict:
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while (answer := self._next()).get("id") != self._count:
            self._note(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']}")
        return answer["result"]

    def open(self, page: Path) -> None:
        self.call("Page.navigate", url=page.resolve().as_uri())
        self.wait("document.readyState === 'complete'")

    def wait(self, condition: str) -> None:
        """Until a JavaScript expression holds; then until what that changed has been drawn."""
        painted = "new Promise(r => requestAnimationFrame(() => requestAnimationFrame(() => r(true))))"
        script = (
            f"(async () => {{ while (!({condition})) await new Promise(r => setTimeout(r, 20)); await {painted}; }})()"
        )
        self.evaluate(script)

    def evaluate(self, script: str):
        result = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in result:
            raise RuntimeError(str(result["exceptionDetails"]))
        return result["result"].get("value")

    def drag(self, start: tuple[int, int], end: tuple[int, int]) -> None:
        self.mouse("mousePressed", start, button="left", clickCount=1)
        for k in range(1, 5):
            self.mouse("mouseMoved", [a + (b - a) * k / 4 for a, b in zip(start, end, strict=True)], button="left")
        self.mouse("mouseReleased", end, button="left", clickCount=1)

    def mouse(self, kind: str, at, **more) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], **more)

    def press(self, key: str) -> None:
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def screenshot(self) -> np.ndarray:
        self.wait("true")
        png = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)

    def _next(self) -> dict:
        while b"\0" not in self._buffer:
            block = os.read(self._read, 1 << 16)
            if not block:
                raise RuntimeError("the browser has ended")
            self._buffer += block
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _note(self, event: dict) -> None:
        parameters = event.get("params", {})
        match event.get("method"):
            case "Runtime.exceptionThrown":
                self.log["exceptions"].append(json.dumps(parameters["exceptionDetails"]))
            case "Runtime.consoleAPICalled":
                self.log["console"].append(json.dumps(parameters["args"]))
            case "Log.entryAdded":
                self.log["console"].append(parameters["entry"]["text"])
            case "Network.requestWillBeSent":
                self.log["requests"].append(parameters["request"]["url"])
