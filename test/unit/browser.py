"""A real Chromium without a window, for tests of pages: opens one, listens to its complaints, takes a picture.

It is talked to through a pair of pipes, with the DevTools protocol; no port is opened, and no network is used.

    python3 test/unit/browser.py PAGE.html PICTURE.png WIDTH HEIGHT     # the upper part of a page, for the docs
"""
from __future__ import annotations

import base64
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
# Without them it looks its maker's hosts up at each start.
QUIET = ("--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-quic",
         "--no-first-run", "--no-default-browser-check", "--disable-extensions")
PATIENCE_S = 60
# It reads from 3 and writes to 4.
HAND_OVER = """
import os, sys
read, write = (os.dup(int(number)) for number in sys.argv[1:3])
read, write = (os.dup(number) if number in (3, 4) else number for number in (read, write))
os.dup2(read, 3)
os.dup2(write, 4)
os.execv(sys.argv[3], sys.argv[3:])
"""


def find_browser() -> str | None:
    """The path of a Chromium, or None."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Browser:
    """One page in a browser of its own; a context manager.

    Args:
        path: of the browser.
        width: of the window, pixels.

    Attributes:
        complaints: what came on the page's console, exceptions, and what it wasn't allowed to do.
        requests: everything that it wanted to load, by URL.
    """

    def __init__(self, path: str, width: int = 1100):
        self._folder = tempfile.TemporaryDirectory()
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-c", HAND_OVER, str(to_browser), str(from_browser), path, "--headless",
             "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--remote-debugging-pipe",
             f"--user-data-dir={self._folder.name}", f"--window-size={width},1000", *QUIET, "about:blank"],
            pass_fds=(to_browser, from_browser), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True)
        os.close(to_browser)
        os.close(from_browser)
        self._received = b""
        self._number = 0
        self._answers: dict = {}
        self._is_loaded = False
        self._session = None
        self.complaints: list = []
        self.requests: list = []

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, *_):
        os.close(self._out)
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait(10)
        os.close(self._in)
        self._folder.cleanup()

    def open(self, page: Path | str) -> None:
        """Open a file or a URL and wait until all of it is there."""
        self._target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=self._target, flatten=True)["sessionId"]
        for room in ("Page", "Runtime", "Log", "Network"):
            self._ask(room + ".enable")
        self._load("Page.navigate", url=page if isinstance(page, str) else page.resolve().as_uri())

    def reload(self) -> None:
        """Load the page again."""
        self._load("Page.reload")

    def _load(self, method, **parameters):
        self._is_loaded = False
        self._ask(method, **parameters)
        self._until(lambda: self._is_loaded)

    def evaluate(self, expression: str) -> Any:
        """What a JavaScript expression is, as JSON has it."""
        answer = self._ask("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def resize(self, width: int) -> None:
        """Give the page so many pixels; a window is never narrower than 500."""
        self._ask("Emulation.setDeviceMetricsOverride", width=width, height=1000, deviceScaleFactor=1, mobile=False)

    def be_phone(self, width: int, height: int, is_dark: bool = False) -> None:
        """Have so many pixels, and be touched."""
        self._ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=True)
        self._ask("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
        self._ask("Emulation.setEmulatedMedia",
                  features=[{"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}])

    def touch(self, kind: str, *points: tuple[float, float]) -> None:
        """Have fingers do "touchStart" or "touchMove" at points, the first finger's first, or all "touchEnd"."""
        self._ask("Input.dispatchTouchEvent", type=kind,
                  touchPoints=[{"x": x, "y": y, "id": finger} for finger, (x, y) in enumerate(points)])

    def key(self, kind: str, key: str) -> None:
        """Press a key by "keyDown", or release it by "keyUp"."""
        self._ask("Input.dispatchKeyEvent", type=kind, key=key, code=f"Key{key.upper()}")

    def hide(self, is_hidden: bool) -> None:
        """Put another tab in front of the page, or the page again."""
        session, self._session = self._session, None
        if is_hidden:
            self._in_front = self._ask("Target.createTarget", url="about:blank")["targetId"]
        else:
            self._ask("Target.closeTarget", targetId=self._in_front)
            self._ask("Target.activateTarget", targetId=self._target)
        self._session = session

    def signal(self, number: int) -> None:
        """Send a signal to all of its processes."""
        os.killpg(self._process.pid, number)

    def picture(self, height: int | None = None) -> bytes:
        """The page down to a height in pixels, or all of it, as PNG."""
        answer = self._ask("Page.captureScreenshot", format="png", captureBeyondViewport=True,
                           clip={"x": 0, "y": 0, "scale": 1,
                                 "width": self.evaluate("document.documentElement.clientWidth"),
                                 "height": height or self.evaluate("document.documentElement.scrollHeight")})
        return base64.b64decode(answer["data"])

    def _ask(self, method, **parameters):
        self._number += 1
        number = self._number
        message = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        self._until(lambda: number in self._answers)
        answer = self._answers.pop(number)
        assert "error" not in answer, answer
        return answer["result"]

    def _until(self, condition):
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([self._in], [], [], left)[0]:
                raise TimeoutError(f"no answer from the browser within {PATIENCE_S} s")
            received = os.read(self._in, 1 << 20)
            if not received:
                raise AssertionError("the browser ended")
            *messages, self._received = (self._received + received).split(b"\0")
            for message in map(json.loads, messages):
                self._hear(message)

    def _hear(self, message):
        event = message.get("method")
        if "id" in message:
            self._answers[message["id"]] = message
        elif event == "Page.loadEventFired":
            self._is_loaded = True
        elif event in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
            self.complaints.append(message["params"])
        elif event == "Network.requestWillBeSent":
            self.requests.append(message["params"]["request"]["url"])


if __name__ == "__main__":
    page, picture, width, height = sys.argv[1:]
    with Browser(find_browser(), int(width)) as browser:
        browser.open(Path(page))
        Path(picture).write_bytes(browser.picture(int(height)))
