"""Chromium as the reports' tests use it: over its debugging pipe, with the page just as it was written."""

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
"""Chromium reads from descriptor 3 and answers on 4."""
PATIENCE = 60.0
"""Seconds: machines that test many things at once are slow."""
SHOWN = "document.readyState === 'complete' && (!$('data') || document.querySelector('#runs tbody'))".replace(
    "$", "document.getElementById"
)
"""Told by a page that has drawn itself, or has no script."""
TOLD = {"Log.entryAdded", "Runtime.exceptionThrown", "Runtime.consoleAPICalled"}


class Browser:
    """One Chromium, told in JSON what to do: each message ends in a zero byte."""

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
        """What the browser answers; what it tells meanwhile is kept in ``events``."""
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
    """The browser of this process; a test without one is skipped."""
    if CHROMIUM is None:
        pytest.skip("Chromium is not installed: the report is not tested in a browser")
    made = Browser()
    atexit.register(made.close)
    return made


class Tab:
    """A page that is shown."""

    def __init__(self, session: str) -> None:
        self._session = session

    def do(self, method: str, **params: Any) -> Any:
        return browser().do(method, self._session, **params)

    def run(self, script: str) -> Any:
        """What the body of a function returns, run in the page."""
        expression = f"(async () => {{ {script} }})()"
        found = self.do("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, condition: str) -> None:
        """Until an expression is true in the page."""
        until = time.monotonic() + PATIENCE
        while not self.run(f"return Boolean({condition});"):
            assert time.monotonic() < until, f"{condition} within {PATIENCE:g} s"
            time.sleep(0.02)

    def settle(self) -> None:
        """Until whatever the last events asked for is drawn."""
        self.run("""let frames = 0;
          while (frames++ < 2 || document.querySelector("[aria-busy='true']")) {
            await new Promise(requestAnimationFrame);
          }""")

    def texts(self, which: str) -> list[str]:
        """What stands in the elements of a selector."""
        every = f"[...document.querySelectorAll({json.dumps(which)})]"
        found: list[str] = self.run(f"return {every}.map((each) => each.textContent);")
        return found

    def text(self, which: str) -> str:
        return self.texts(which)[0]

    def picture(self, place: int = 0) -> str:
        """What differs if the picture on a canvas does."""
        drawn: str = self.run(f"return document.querySelectorAll('canvas')[{place}].toDataURL();")
        return drawn

    def choose(self, which: str, value: str) -> None:
        """Give a control a value, as a user does."""
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
        """``kind``: Moved, Pressed, Released or Wheel."""
        pressed = {"button": "left", "clickCount": 1} if kind in ("Pressed", "Released") else {}
        self.do("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **pressed | more)
        self.settle()

    def troubles(self) -> list[str]:
        """What the console holds, exceptions among it, and the addresses that were asked for."""
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
    """The page in a window of so many pixels, enlarged by ``zoom``; it has no trouble while it is there."""
    target = browser().do("Target.createTarget", url="about:blank")["targetId"]
    tab = Tab(browser().do("Target.attachToTarget", targetId=target, flatten=True)["sessionId"])
    for domain in ("Page", "Runtime", "Network", "Log"):
        tab.do(f"{domain}.enable")
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
    """An empty folder that takes what pages download meanwhile."""
    with tempfile.TemporaryDirectory() as folder:
        browser().do("Browser.setDownloadBehavior", behavior="allow", downloadPath=folder)
        yield Path(folder)
        browser().do("Browser.setDownloadBehavior", behavior="deny")
