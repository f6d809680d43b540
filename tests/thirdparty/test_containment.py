"""Plugins that print, leave, raise what nobody expects or hide behind odd names: told by name, kept out."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from thirdparty.installing import environment, unpack, write_wheel

pytestmark = pytest.mark.slow

HEAD = "import os, sys\nfrom agglo_core import Command, Component, hookimpl\n"
HOOK = "\n@hookimpl\ndef agglo_components():\n    return [{}]\n"
PART = """
import os
import numpy as np

class Part:
    def bisect(self, graph, rng):
        {}
        return np.arange(graph.n) >= (graph.n + 1) // 2
"""


def declaring(name: str, more: str = "", kind: str = "'bisector'", called: str = "") -> str:
    """A declaration of one bisector, whose code is in the module ``code`` beside it."""
    return HEAD + HOOK.format(f"Component({kind}, {called or repr(name)}, 'agglo_{name}.code:Part', {more})")


FAKES = {
    "escapist": HEAD + "raise GeneratorExit('at import')",
    "cancelled": HEAD + "class Cancelled(BaseException): ...\nraise Cancelled('at import')",
    "hooked": HEAD + "@hookimpl\ndef agglo_components():\n    raise GeneratorExit('in the hook')",
    "faceless": HEAD
    + "class Faceless:\n    def __repr__(self): raise KeyError('face')\n"
    + HOOK.format("Faceless()"),
    "nameless": HEAD
    + "class Faceless:\n    def __repr__(self): raise KeyError('face')\n"
    + HOOK.format("Component('bisector', Faceless(), 'm:C', summary=Faceless())"),
    "mute": HEAD + "class Mute(Exception):\n    def __str__(self): raise ValueError\nraise Mute",
    "writer": "import os\nos.write(1, b'@@ import')\nprint('@@ import')\n" + declaring("writer"),
    "wanderer": "import os\nos.chdir('/')\n" + declaring("wanderer"),
    "painter": declaring("painter", "summary='\\x1b[31mred'"),
    "wide": declaring("wide", called="'\\uff4bmeans'"),
    "cyrillic": declaring("cyrillic", called="'km\\u0435ans'"),
    "versioned": declaring("versioned", "requires=('numpy>=99',)"),
    "slow": "import time\ntime.sleep(2.1)\n" + declaring("slow"),
    "patient": declaring("patient"),
}
CODE = {
    "writer": PART.format("os.write(1, b'@@ call'); print('@@ call')"),
    "wanderer": PART.format("os.chdir('/')"),
    "patient": PART.format("pass"),
    "slow": PART.format("pass"),
}
REASONS = {
    "escapist": "importing 'agglo_escapist' raised GeneratorExit: at import",
    "cancelled": "importing 'agglo_cancelled' raised Cancelled: at import",
    "hooked": "agglo_components() raised GeneratorExit: in the hook",
    "faceless": "agglo_components()[0] is a Faceless that cannot be printed, expected a Component",
    "nameless": "name a Faceless that cannot be printed is not an identifier",
    "mute": "importing 'agglo_mute' raised Mute: (its message cannot be printed)",
    "painter": r"contains control characters",
    "wide": "is not an identifier",
    "cyrillic": "is not an identifier",
    "versioned": "requires 'numpy>=99', expected a module name as in 'import NAME'",
}


def put(site: Path, name: str, declaration: str, code: str = "") -> None:
    """Install a distribution with one plugin into ``site``."""
    files = {f"agglo_{name}/__init__.py": declaration, f"agglo_{name}/code.py": code}
    unpack(site, write_wheel(site, f"agglo-{name}", "0.1", files, f"{name} = agglo_{name}"))


def agglo(site: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a command line in a process of its own, as a shell would."""
    return subprocess.run(
        [sys.executable, "-m", "agglo_core", *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env=environment(site),
        check=False,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Site folder with all of them."""
    folder = tmp_path_factory.mktemp("site")
    for name, declaration in FAKES.items():
        put(folder, name, declaration, CODE.get(name, ""))
    return folder


@pytest.fixture(scope="module")
def listing(
    site: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[dict[str, object]], subprocess.CompletedProcess[str]]:
    """What ``agglo plugins`` says of them: as data, and for people."""
    folder = tmp_path_factory.mktemp("work")
    done = agglo(site, folder, "plugins", "--json")
    return json.loads(done.stdout), agglo(site, folder, "plugins", "-v")


@pytest.mark.parametrize("name", REASONS)
def test_what_cannot_be_used_is_listed_with_the_reason(
    name: str, listing: tuple[list[dict[str, object]], subprocess.CompletedProcess[str]]
) -> None:
    records, table = listing
    (record,) = (each for each in records if each["plugin"] == name)
    assert record["state"] == "broken"
    assert REASONS[name] in str(record["reason"])
    assert "\x1b" not in table.stdout
    assert table.returncode == 0


def test_only_slow_imports_are_named(
    listing: tuple[list[dict[str, object]], subprocess.CompletedProcess[str]],
) -> None:
    records, table = listing
    (slow,) = (line for line in table.stdout.splitlines() if "slow: importing" in line)
    assert "importing plugin 'slow' took 2." in slow
    seconds = {str(each["plugin"]): each["import_seconds"] for each in records}
    assert float(str(seconds["patient"])) < 1 < float(str(seconds["slow"]))


def test_what_a_plugin_writes_does_not_reach_stdout(site: Path, tmp_path: Path) -> None:
    run = ("run", "strip:n=8", "--bisector", "writer", "--parts", "4")
    done = agglo(site, tmp_path, *run, "--json")
    (only,) = json.loads(done.stdout)["runs"]
    assert only["bisector"] == "writer"
    assert "@@ call" in done.stderr
    assert "@@ import" in done.stderr
    quiet = agglo(site, tmp_path, *run, "--quiet")
    assert quiet.returncode == 0
    assert "@@" not in quiet.stdout + quiet.stderr


def test_c_code_that_writes_does_not_reach_stdout(site: Path, tmp_path: Path) -> None:
    """As METIS does, through the buffered stdout of the C library."""
    code = "import ctypes\n" + PART.format("ctypes.CDLL(None).printf(b'*** error of a C library\\n')")
    put(tmp_path, "metislike", declaring("metislike"), code)
    done = agglo(tmp_path, tmp_path, "run", "strip:n=8", "--bisector", "metislike", "--parts", "4", "--json")
    assert json.loads(done.stdout)["runs"]
    assert "***" in done.stderr


def test_a_plugin_that_leaves_the_folder_is_brought_back(site: Path, tmp_path: Path) -> None:
    run = ("run", "strip:n=8", "--bisector", "wanderer", "--parts", "4", "-o", "out.npz")
    done = agglo(site, tmp_path, *run)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.npz").exists()
    assert "plugin wanderer (agglo-wanderer) changed the current folder; it was changed back" in done.stderr
    assert "bisector 'wanderer' (plugin 'wanderer', distribution agglo-wanderer 0.1) changed" in done.stderr


def test_an_interrupt_says_where(tmp_path: Path) -> None:
    put(tmp_path, "stopper", "raise KeyboardInterrupt")
    done = agglo(tmp_path, tmp_path, "plugins")
    assert done.returncode == 130
    assert "interrupted while loading plugin stopper (agglo-stopper)" in done.stderr
    assert "Traceback" not in done.stderr
