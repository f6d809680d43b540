"""Build distributions, install them by pip into a separate folder, and run agglo with this folder."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Answer", "converse", "environment", "install", "unpack", "write_wheel"]

_OFFLINE = ("--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check")

_CONVERSATION = """
import contextlib, io, json, sys
from agglo_core.cli import main
answers = []
for arguments in json.load(sys.stdin):
    out, err, code = io.StringIO(), io.StringIO(), None
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(arguments)
        except SystemExit as done:
            code = done.code
    answers.append((code, out.getvalue(), err.getvalue()))
print(json.dumps(answers))
"""


@dataclass(frozen=True)
class Answer:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


def write_wheel(folder: Path, distribution: str, version: str, files: Mapping[str, str], points: str) -> Path:
    """Write the wheel of a pure distribution with ``files`` by path and the agglo entry points ``points``."""
    stem = f"{distribution.replace('-', '_')}-{version}"
    info = {
        "METADATA": f"Metadata-Version: 2.1\nName: {distribution}\nVersion: {version}\n",
        "WHEEL": "Wheel-Version: 1.0\nGenerator: tests\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        "entry_points.txt": f"[agglo]\n{points}\n",
    }
    content = {**files, **{f"{stem}.dist-info/{name}": text for name, text in info.items()}}
    record = f"{stem}.dist-info/RECORD"
    content[record] = "".join(f"{name},,\n" for name in (*content, record))
    wheel = folder / f"{stem}-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, text in content.items():
            archive.writestr(name, text)
    return wheel


def unpack(site: Path, *wheels: Path) -> None:
    """Install pure wheels into ``site`` as pip does, without starting it."""
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(site)


def install(site: Path, *what: Path) -> None:
    """Install wheels and source trees into ``site``, without network, dependencies or isolation."""
    command = [sys.executable, "-m", "pip", "install", *_OFFLINE, "--target", str(site), *map(str, what)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def environment(site: Path) -> dict[str, str]:
    """Return the environment of a program that imports from ``site`` first."""
    paths = (str(site), os.environ.get("PYTHONPATH", ""))
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}


def converse(site: Path, commands: Sequence[Sequence[str]], folder: Path) -> list[Answer]:
    """Run agglo command lines in sequence in a new interpreter that imports from ``site``."""
    done = subprocess.run(
        [sys.executable, "-c", _CONVERSATION],
        input=json.dumps(list(commands)),
        capture_output=True,
        text=True,
        env=environment(site),
        cwd=folder,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return [Answer(*answer) for answer in json.loads(done.stdout)]
