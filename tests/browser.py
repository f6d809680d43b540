"""Reports as data, and as Chromium shows them."""

from __future__ import annotations

import base64
import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np

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
    "--enable-logging=stderr",
    "--virtual-time-budget=3000",
    "--window-size=1200,900",
    "--dump-dom",
)
KINDS = {"Uint8": "<u1", "Uint16": "<u2", "Uint32": "<u4", "Float32": "<f4"}


def data_of(page: Path) -> dict[str, Any]:
    (found,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page.read_text())
    data: dict[str, Any] = json.loads(found)
    return data


def unpacked(packed: dict[str, str]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(packed["data"]), KINDS[packed["type"]])


def visited(page: Path, folder: Path, fragment: str, script: str) -> Any:
    """What a script returns that is run in the page, opened at ``fragment``; the folder takes a copy."""
    probe = f"""<script>
      const pre = document.createElement("pre");
      pre.id = "answer";
      pre.textContent = JSON.stringify((() => {{ {script} }})());
      document.body.append(pre);
    </script></body>"""
    copy = folder / "copy.html"
    text = re.sub(r"script-src '[^']*'", "script-src 'unsafe-inline'", page.read_text())
    copy.write_text(text.replace("</body>", probe))
    assert CHROMIUM is not None
    done = subprocess.run(
        [CHROMIUM, *FLAGS, f"--user-data-dir={folder / 'profile'}", f"{copy.as_uri()}#{fragment}"],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert not [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    (answer,) = re.findall(r'<pre id="answer">(.*?)</pre>', done.stdout)
    return json.loads(html.unescape(answer))
