"""Whatever the encoding of the output: a run ends well, what it lacks is readable, JSON is JSON."""

from __future__ import annotations

import codecs
import io
import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import click
import pytest
from command_line import Agglo

from agglo_core.cli import main
from agglo_core.cli.output.encoding import can_show, readable_output, replace_unencodable
from agglo_core.registry.containment import printable

ENCODINGS = ("ascii", "cp1252", "latin-1", "cp437", "koi8-r", "utf-8")


@pytest.fixture(params=ENCODINGS)
def encoding(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def output(monkeypatch: pytest.MonkeyPatch, encoding: str) -> io.TextIOWrapper:
    """A new stdout, which as stderr has an encoding that raises where it cannot."""
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    assert isinstance(sys.stdout, io.TextIOWrapper)
    return sys.stdout


def ended(*arguments: str) -> int:
    with pytest.raises(SystemExit) as done:
        main(arguments)
    assert isinstance(done.value.code, int)
    return done.value.code


def text_of(stream: object) -> str:
    assert isinstance(stream, io.TextIOWrapper)
    stream.flush()
    buffer = stream.buffer
    assert isinstance(buffer, io.BytesIO)
    return buffer.getvalue().decode(stream.encoding)


def test_tables_and_help_survive(monkeypatch: pytest.MonkeyPatch, encoding: str, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    stdout = output(monkeypatch, encoding)
    assert ended("run", "squares:n=4", "--bisector", "inertial", "--h-factor", "2") == 0
    assert ended("compare", "squares:n=4", "--bisector", "inertial,kmeans", "--method", "kway") == 0
    assert ended("solve", "squares:n=4", "--bisector", "inertial") == 0
    assert ended("solve", "--help") == 0
    assert ended("plugins", "-v") == 0
    text = text_of(stdout)
    size = "h ≤ 2 h0" if can_show("≤", stdout) else "h <= 2 h0"
    assert size in text
    assert ("energy fᵀu" in text) == can_show("ᵀ", stdout)
    assert ("energy f^Tu" in text) != can_show("ᵀ", stdout)
    assert ("┃ bisector ┃" in text) == can_show("┏┃╇", stdout)
    assert "?" not in text.replace("\\?", "")
    assert (stdout.encoding, stdout.errors) == (encoding, "strict")


def test_errors_and_notes_survive(monkeypatch: pytest.MonkeyPatch, encoding: str, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    stdout = output(monkeypatch, encoding)
    logging.getLogger("agglo").warning("before")
    assert ended("run", "größe≤∞網") == 2
    said = text_of(sys.stderr)
    assert said.startswith("error: ")
    assert "Traceback" not in said
    known = "größe≤∞網".encode(stdout.encoding, "ignore").decode(stdout.encoding)
    assert all(letter in said for letter in known)
    assert "?" not in said


def test_json_is_json(monkeypatch: pytest.MonkeyPatch, encoding: str, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    stdout = output(monkeypatch, encoding)
    assert ended("mesh", "squares:n=2", "-o", "nœud≤網.vtu", "--quiet") == 0
    assert ended("run", "nœud≤網.vtu", "--parts", "2", "--bisector", "inertial", "--json") == 0
    text = text_of(stdout)
    assert text.isascii()
    assert json.loads(text)["mesh"]["name"] == "nœud≤網"


def test_names_that_are_no_text_are_shown(agglo: Agglo) -> None:
    name = os.fsdecode(b"\xff.vtu")
    assert agglo("mesh", "squares:n=2", "-o", name).out == "wrote \\xff.vtu: 4 cells, 9 points\n"


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("h ≤ 2 h0 – fᵀu → 2π² κ∇u ∞", "h <= 2 h0 - f^Tu -> 2pi^2 kappagrad u inf"),
        ("café Ångström ½", "cafe Angstrom 1/2"),
        ("┏━┳│⠋█", "+-+|*#"),
        ("網 \udcff", "\\u7db2 \\xff"),
        ("Λ λ ξ", "lambda lambda xi"),
    ],
)
def test_replacements_can_be_read(text: str, wanted: str) -> None:
    assert replace_unencodable(text, io.TextIOWrapper(io.BytesIO(), encoding="ascii")) == wanted


def test_control_characters_are_shown_not_sent(agglo: Agglo) -> None:
    assert printable("a\x1b[2Jb\x07\tc\u202e") == "a\\x1b[2Jb\\x07 c\\u202e"
    done = agglo("run", "a\x1b[31mb")
    assert done.code == 2
    assert "\x1b" not in done.err


def test_streams_are_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    with readable_output():
        click.echo("≤")
        print("≥")  # noqa: T201 - what a plugin may do
    assert text_of(stream) == "<=\n>=\n"
    assert (stream.encoding, stream.errors) == ("ascii", "strict")
    with pytest.raises(LookupError):
        codecs.lookup("agglo_ascii")


@pytest.mark.slow
def test_a_process_of_its_own(tmp_path: Path) -> None:
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    command = [sys.executable, "-m", "agglo_core", "run", "squares:n=4", "--h-factor", "2"]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert b"h <= 2 h0" in done.stdout
    assert done.stdout.isascii()
