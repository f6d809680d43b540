"""Drive Chromium over its debugging pipe, with report pages exactly as written."""

from __future__ import annotations

import atexit
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-sync",
    "--disable-component-update",
    "--disable-background-networking",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)
LAUNCH = """
import os, sys
os.dup2(int(sys.argv[1]), 3)
os.dup2(int(sys.argv[2]), 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""Start Chromium so that it reads from descriptor 3 and writes to descriptor 4."""
PATIENCE = 60.0
"""Timeout in seconds; busy machines are slow."""
SHOWN = "document.readyState === 'complete' && (!$('data') || document.querySelector('#runs tbody'))".replace(
    "$", "document.getElementById"
)
"""Script condition: true once the page has drawn itself, or has no script."""
TOLD = {"Log.entryAdded", "Runtime.exceptionThrown", "Runtime.consoleAPICalled"}


class Browser:
    """Chromium process, controlled by JSON messages that end in a zero byte."""

    def __init__(self) -> None:
        assert CHROMIUM is not None
        self.folder = tempfile.mkdtemp(prefix="browser-")
        theirs, self._out = os.pipe()
        self._in, answers = os.pipe()
        theirs, answers = (_moved(each, beyond=4) for each in (theirs, answers))
        command = [sys.executable, "-Ic", LAUNCH, str(theirs), str(answers), CHROMIUM, *FLAGS]
        self._process = subprocess.Popen(
            [*command, f"--user-data-dir={self.folder}/profile"],
            pass_fds=(theirs, answers),
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs)
        os.close(answers)
        self._number, self._read = 0, b""
        self.events: list[dict[str, Any]] = []

    def do(self, method: str, session: str | None = None, **params: Any) -> Any:
        """Call a method of the browser and return its result.

        Events in between are kept in ``events``.
        """
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        os.write(
            self._out, json.dumps(message | ({"sessionId": session} if session else {})).encode() + b"\0"
        )
        until = time.monotonic() + PATIENCE
        while True:
            answer = self._message(until)
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self.events.append(answer)

    def _message(self, until: float) -> dict[str, Any]:
        while b"\0" not in self._read:
            ready, _, _ = select.select([self._in], [], [], max(until - time.monotonic(), 0.0))
            assert ready, f"no answer within {PATIENCE:g} s"
            more = os.read(self._in, 1 << 20)
            assert more, "Chromium has ended"
            self._read += more
        first, self._read = self._read.split(b"\0", 1)
        found: dict[str, Any] = json.loads(first)
        return found

    def close(self) -> None:
        self.do("Browser.close")
        self._process.wait(PATIENCE)
        shutil.rmtree(self.folder, ignore_errors=True)


def _moved(descriptor: int, beyond: int) -> int:
    copy = fcntl.fcntl(descriptor, fcntl.F_DUPFD, beyond + 1)
    os.close(descriptor)
    return copy


@cache
def browser() -> Browser:
    """Return the browser of this process, or skip the test if Chromium is not installed."""
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: the report is not tested in a browser")
    made = Browser()
    atexit.register(made.close)
    return made


class Tab:
    """Open page."""

    def __init__(self, session: str) -> None:
        self._session = session

    def do(self, method: str, **params: Any) -> Any:
        return browser().do(method, self._session, **params)

    def run(self, script: str) -> Any:
        """Run a function body in the page and return its result."""
        expression = f"(async () => {{ {script} }})()"
        found = self.do("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until an expression is true in the page."""
        until = time.monotonic() + PATIENCE
        while not self.run(f"return Boolean({condition});"):
            assert time.monotonic() < until, f"{condition} within {PATIENCE:g} s"
            time.sleep(0.02)

    def settle(self) -> None:
        """Wait until the page has been drawn after the last events."""
        self.run("""let frames = 0;
          while (frames++ < 2 || document.querySelector("[aria-busy='true']")) {
            await new Promise(requestAnimationFrame);
          }""")

    def texts(self, which: str) -> list[str]:
        """Return the texts of all elements that match a selector."""
        every = f"[...document.querySelectorAll({json.dumps(which)})]"
        found: list[str] = self.run(f"return {every}.map((each) => each.textContent);")
        return found

    def text(self, which: str) -> str:
        return self.texts(which)[0]

    def picture(self, place: int = 0) -> str:
        """Return the content of a canvas as a data URL, for comparisons."""
        drawn: str = self.run(f"return document.querySelectorAll('canvas')[{place}].toDataURL();")
        return drawn

    def choose(self, which: str, value: str) -> None:
        """Set the value of a control and send the events of a user."""
        self.run(f"""const control = document.querySelector({json.dumps(which)});
          control.value = {json.dumps(value)};
          for (const event of ["input", "change"]) control.dispatchEvent(new Event(event));""")
        self.settle()

    def press(self, *keys: str) -> None:
        for key in keys:
            text = {"text": key} if len(key) == 1 else {}
            self.do("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
            self.do("Input.dispatchKeyEvent", type="keyUp", key=key)
        self.settle()

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """Send a mouse event.

        ``kind`` is Moved, Pressed, Released or Wheel.
        """
        pressed = {"button": "left", "clickCount": 1} if kind in ("Pressed", "Released") else {}
        self.do("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **pressed | more)
        self.settle()

    def troubles(self) -> list[str]:
        """Return the console messages, exceptions and requested addresses."""
        own = [each for each in browser().events if each.get("sessionId") == self._session]
        said = [json.dumps(each["params"]) for each in own if each["method"] in TOLD]
        asked = [each["params"] for each in own if each["method"] == "Network.requestWillBeSent"]
        return said + [each["request"]["url"] for each in asked if each["type"] != "Document"]


@contextmanager
def visited(
    page: Path,
    fragment: str = "",
    width: int = 1200,
    height: int = 900,
    zoom: float = 1.0,
    dark: bool = False,
) -> Iterator[Tab]:
    """Show the page in a window of this size in pixels, enlarged by ``zoom``.

    At the end, the page must have no console messages or requests.
    """
    # Open a tab and enable the events.
    target = browser().do("Target.createTarget", url="about:blank")["targetId"]
    tab = Tab(browser().do("Target.attachToTarget", targetId=target, flatten=True)["sessionId"])
    for domain in ("Page", "Runtime", "Network", "Log"):
        tab.do(f"{domain}.enable")
    # Set window size, zoom and colour scheme, then load the page.
    sizes = {"width": round(width / zoom), "height": round(height / zoom)}
    tab.do("Emulation.setDeviceMetricsOverride", **sizes, deviceScaleFactor=zoom, mobile=False)
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    tab.do("Emulation.setEmulatedMedia", features=[scheme])
    tab.do("Page.navigate", url=f"{page.as_uri()}#{fragment}")
    tab.wait(SHOWN)
    tab.settle()
    try:
        yield tab
        assert tab.troubles() == []
    finally:
        browser().do("Target.closeTarget", targetId=target)


@contextmanager
def downloads() -> Iterator[Path]:
    """Yield an empty folder that receives downloads."""
    with tempfile.TemporaryDirectory() as folder:
        browser().do("Browser.setDownloadBehavior", behavior="allow", downloadPath=folder)
        yield Path(folder)
        browser().do("Browser.setDownloadBehavior", behavior="deny")
