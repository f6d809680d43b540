"""What the shell offers: asked as the scripts ask, and once in a real bash with the Tab key."""

from __future__ import annotations

import os
import pty
import re
import select
import shutil
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from agglo_core.cli.app import app


def offered(line: str) -> list[str]:
    """What bash is told after a line, as whole last words."""
    asked = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_AGGLO_COMPLETE": "bash_complete"}
    answer = CliRunner().invoke(app, prog_name="agglo", env=asked).output
    word = "" if line[-1].isspace() else line.split()[-1]
    kept = word[: max(word.rfind(":"), word.rfind("=")) + 1]
    told = [each.split(",", 1) for each in answer.splitlines() if each]
    assert {kind for kind, _ in told} <= {"plain"}
    return [kept + text for _, text in told]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("agglo ru", ["run "]),
        ("agglo run hexa", ["hexagons "]),
        ("agglo mesh voronoi:s", ["voronoi:seed="]),
        ("agglo run m.vtu --bisector metis:contig=t", ["metis:contig=true "]),
        ("agglo run m.vtu --bisector kmeans:effort=g", ["kmeans:effort=good "]),
        ("agglo run m.vtu --bisector kmeans:effort=good,eff", []),
        ("agglo run m.vtu --bisector kmeans,spe", ["kmeans,spectral "]),
        ("agglo run m.vtu --bisector kmeans:effort=good,spe", ["kmeans:effort=good,spectral "]),
        ("agglo run m.vtu --bisector kmeans:effort=good,obj", ["kmeans:effort=good,objective="]),
        ("agglo run m.vtu --refiner no", ["none "]),
        ("agglo run m.vtu --metrics UF,CRc", ["UF,CRc "]),
        ("agglo run m.vtu --boundary-rules ", ["ridges "]),
        ("agglo solve squares:n=4 --solver dir", ["direct "]),
        ("agglo solve squares:n=4 --problem const", ["constant "]),
        ("agglo check bisector:spec", ["bisector:spectral "]),
        ("agglo plugins spec", ["spectral "]),
        ("agglo completion z", ["zsh "]),
        ("agglo run m.vtu --bisector nobody:", []),
    ],
)
def test_completions_of_a_line(line: str, expected: list[str]) -> None:
    assert offered(line) == expected


def test_where_no_sample_begins_so_the_shell_offers_files() -> None:
    line = "agglo run ./"
    asked = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_AGGLO_COMPLETE": "bash_complete"}
    assert CliRunner().invoke(app, prog_name="agglo", env=asked).output == "file,\n"


def test_options_that_were_given_are_not_offered_again() -> None:
    words = offered("agglo run m.vtu --bisector metis:ufactor=30,")
    assert "metis:ufactor=30,contig=" in words
    assert "metis:ufactor=30,kmeans " in words
    assert "metis:ufactor=30,ufactor=" not in words


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_for_each_shell(shell: str) -> None:
    script = CliRunner().invoke(app, ["completion", shell]).output
    assert f"_AGGLO_COMPLETE={shell}_complete" in script
    assert "agglo" in script.splitlines()[-1] + script.splitlines()[0]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not there")
def test_the_tab_key_in_a_real_bash(tmp_path: Path) -> None:
    here = Path(sys.executable).parent / "agglo"
    if not here.exists():
        pytest.skip("the command agglo is not installed beside this python")
    child, terminal = pty.fork()
    if child == 0:
        path = f"{here.parent}{os.pathsep}{os.environ['PATH']}"
        os.execvpe("bash", ["bash", "--norc", "--noprofile", "-i"], os.environ | {"PATH": path, "PS1": "> "})
    try:
        _typed(terminal, 'eval "$(agglo completion bash)"; echo rea""dy\n', "ready")
        shown = _typed(terminal, "agglo run m.vtu --bisector kmeans:effort=g\t", "effort=good")
        assert re.search(r"--bisector kmeans:effort=good ", shown)
    finally:
        os.close(terminal)
        os.waitpid(child, 0)


def _typed(terminal: int, keys: str, wanted: str) -> str:
    """What the terminal shows after these keys, once ``wanted`` is among it."""
    os.write(terminal, keys.encode())
    shown, end = "", time.monotonic() + 60
    while wanted not in shown:
        assert time.monotonic() < end, shown
        if select.select([terminal], [], [], 1.0)[0]:
            shown += os.read(terminal, 4096).decode(errors="replace")
    return shown
