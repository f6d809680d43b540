"""Tables of the command line on terminals of any width: no number is cut, and what is left out is named."""

from __future__ import annotations

import importlib
import json
import os
import pty
import random
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import Agglo
from terminal import Screen, set_width, terminal

from agglo_core import samples
from agglo_core.cli import main
from agglo_core.cli.output.tables import Table, fold_text, lay_out_table
from agglo_core.conformance import Result

WIDTHS = (80, 60, 40)
METRICS = "UF,CR,CRc,convexity,cells,isoperimetric,box_ratio,cut,ncut,balance"

Show = Callable[..., str]


@pytest.fixture(params=WIDTHS)
def show(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Show:
    """Function that runs ``agglo`` on a terminal and returns what it printed there."""

    def call(*arguments: str, code: int = 0) -> str:
        with terminal(monkeypatch, request.param) as screen, pytest.raises(SystemExit) as done:
            main(arguments)
        assert done.value.code == code
        assert max(map(len, screen.text.splitlines())) <= request.param
        return screen.text

    return call


def left_out(text: str) -> set[str]:
    """Columns that are said to be missing."""
    said = re.search(r"left out: (.*?);", " ".join(text.split()))
    return set(said[1].split(", ")) if said else set()


def assert_whole(text: str, wanted: dict[str, str]) -> None:
    """Each value of a column stands there as a word of its own, unless the column is said to be missing."""
    for name, value in wanted.items():
        found = re.search(rf"(?<![\w.]){re.escape(value)}(?![\w.])", text)
        assert found or name in left_out(text), f"{name} = {value} in\n{text}"


def cells_of(run: dict[str, Any]) -> Iterator[dict[str, str]]:
    """What the table says of each level of a run, by the name of the column."""
    for level in run["levels"]:
        values = {**level, **level.get("objectives", {})}
        numbers = {name: f"{each:.3f}" for name, each in values.items() if isinstance(each, float)}
        for absent in ("target", "max_diameter"):
            numbers.pop(absent, None)
        if "diameter_ratio" in numbers:
            numbers["mean diam/h*"] = numbers.pop("diameter_ratio")
        numbers["cells each"] = f"{level['min_cells']}–{level['max_cells']}"
        yield numbers | {"K": str(level["parts"]), "connected": f"{100 * level['connected']:.4g} %"}


def test_numbers_of_runs_are_whole(show: Show, agglo: Agglo) -> None:
    ask = ["voronoi:n=300,seed=2", "--bisector", "inertial,coordinate", "--h-factor", "2,4,8"]
    data = json.loads(agglo("compare", *ask, "--json").out)
    for command in ("run", "compare"):
        text = show(command, *ask)
        assert text.startswith("voronoi n=300 seed=2: 300")
        assert_whole(text, {"target": "≤ 2 h0"})
        for run in data["runs"]:
            for numbers in cells_of(run):
                assert_whole(text, numbers)


def test_numbers_of_many_metrics_are_whole(show: Show, agglo: Agglo) -> None:
    ask = ["squares:n=6", "--bisector", "coordinate", "--parts", "7,3", "--metrics", METRICS]
    text = show("compare", *ask)
    for run in json.loads(agglo("compare", *ask, "--json").out)["runs"]:
        for numbers in cells_of(run):
            assert_whole(text, numbers)


def test_failed_runs_say_why_below_the_table(show: Show) -> None:
    text = show("compare", "squares:n=4", "--bisector", "inertial,kmeans", "--method", "kway")
    assert "inertial: not implemented: it has no k-way partition" in " ".join(text.split())


def test_numbers_of_a_demo_are_whole(show: Show, agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "brain", lambda: samples.ring(24))
    monkeypatch.setattr(
        importlib.import_module("agglo_core.cli.commands.demo"), "find_spec", lambda name: None
    )
    ask = ["demo", "--bisector", "kmeans:iterations=5,inertial"]
    text = show(*ask)
    for run in json.loads(agglo(*ask, "--json").out)["runs"]:
        assert_whole(text, next(cells_of(run)))
    assert "iterations=5" in text


def test_numbers_of_a_file_are_whole(show: Show, agglo: Agglo) -> None:
    ask = ["voronoi:n=300,seed=2", "--bisector", "inertial", "--h-factor", "2,4,8"]
    agglo("run", *ask, "-o", "out.npz", "--quiet")
    for pick in ([], ["--metrics", METRICS]):
        text = show("quality", "out.npz", *pick)
        for level in json.loads(agglo("quality", "out.npz", *pick, "--json").out)["levels"]:
            level |= level.pop("objectives", {})
            for name, value in level.items():
                assert_whole(text, {name: f"{value:.4g}" if isinstance(value, float) else str(value)})


def test_laws_are_whole(show: Show, monkeypatch: pytest.MonkeyPatch) -> None:
    results = [
        Result("same_seed_same_result", "Two objects built alike agree.", "ok", "", 12.345, "deterministic"),
        Result("bounds", "Values are within bounds.", "FAILS", "value 1234.5678 of part 17 is above 1", 0.5),
    ]
    monkeypatch.setattr("agglo_core.conformance.check", lambda *_, **__: results)
    text = show("check", "metric:cells", code=3)
    assert_whole(text, {"seconds": "12.35", "value": "1234.5678", "part": "17", "state": "FAILS"})
    assert "metric:cells: 1 of 2 laws hold" in text


def test_listings_are_whole(show: Show, agglo: Agglo) -> None:
    text = show("plugins")
    words = " ".join(text.split())
    for record in json.loads(agglo("plugins", "--json").out):
        assert all(part in text for part in re.split("(?<=[_-])", record["name"]))
        assert_whole(text, {"plugin": record["plugin"]})
    assert "Moves boundary" in words
    card = " ".join(show("plugins", "metis").split())
    assert "ufactor: a whole number or none; default None" in card


def test_sentences_are_folded_between_words(show: Show) -> None:
    words = " ".join(show("solve", "squares:n=8", "--bisector", "inertial").split())
    assert re.search(
        r"\d+ iterations \(tolerance met by residual and energy error\), relative residual \d\.\d\de-0\d",
        words,
    )
    written = show("mesh", "squares:n=100", "-o", "out.vtu")
    assert " ".join(written.split()) == "wrote out.vtu: 10,000 cells, 10,201 points"


@pytest.mark.slow
def test_a_real_terminal(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    set_width(slave, 80)
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    command = [sys.executable, "-m", "agglo_core", "run", "squares:n=16", "--parts", "100"]
    done = subprocess.Popen(command, stdout=slave, stderr=subprocess.DEVNULL, cwd=tmp_path, env=environment)
    os.close(slave)
    screen = Screen()
    screen.read(master)
    os.close(master)
    assert done.wait() == 0
    assert re.search(r"kmeans +100 parts +100 +\d–\d( +0\.\d{3}){5} +\d\.\d\d", screen.text)
    assert max(map(len, screen.text.splitlines())) <= 80


def test_errors_are_folded_to_the_terminal(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    set_width(slave, 60)
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    command = [sys.executable, "-m", "agglo_core", "run", "squares:n=4", "--bisector", "nope"]
    done = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=slave, cwd=tmp_path, env=environment)
    os.close(slave)
    screen = Screen()
    screen.read(master)
    os.close(master)
    assert done.wait() == 2
    assert max(map(len, screen.text.splitlines())) <= 60
    assert "no bisector is named 'nope'; available: coordinate," in " ".join(screen.text.split())


@pytest.mark.slow
@pytest.mark.parametrize("more", [[], ["--json"]])
def test_what_was_closed_stays_silent(tmp_path: Path, more: list[str]) -> None:
    command = [sys.executable, "-m", "agglo_core", "mesh", "squares:n=4", "-o", "m.vtu"]
    if more:
        command = [sys.executable, "-m", "agglo_core", "plugins", *more]
    line = ["sh", "-c", 'exec "$@" >&-', "sh", *command]
    done = subprocess.run(line, stderr=subprocess.PIPE, cwd=tmp_path, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert bool(more) or (tmp_path / "m.vtu").exists()


def a_table(rng: random.Random) -> Table:
    count = rng.randrange(1, 9)
    names = ["name", *(f"column {'x' * rng.randrange(9)}{place}" for place in range(count))]
    rows = [
        [f"some:option={rng.randrange(10**6)},other=a", *(f"{rng.random() * 1e5:.4g}" for _ in range(count))]
        for _ in range(rng.randrange(1, 5))
    ]
    return Table(names, rows, names[-2:] if count > 3 else (), {"name": 8})


@pytest.mark.parametrize("seed", range(5))
def test_any_table_at_any_width(seed: int) -> None:
    table = a_table(random.Random(seed))
    for width in range(20, 200, 7):
        for boxed in (True, False):
            lines = lay_out_table(table, width, boxed=boxed)
            text = "\n".join(lines)
            assert width < 45 or max(map(len, lines)) <= width
            for row in table.rows:
                name, *numbers = zip(table.columns, row, strict=True)
                assert_whole(text, dict(numbers))
                assert name[1].split(":")[1].split(",")[0] in text  # option=number


def test_pipes_are_as_wide_as_the_table() -> None:
    table = Table([f"column {i}" for i in range(60)], [[str(10**i) for i in range(60)]], ["column 3"], {})
    (row,) = lay_out_table(table, None, boxed=True)[3:-1]
    assert [cell.strip() for cell in row.strip("│").split("│")] == [str(10**i) for i in range(60)]


def test_wide_letters_take_two_columns() -> None:
    rows = [["網格", "1"], ["e\u0301te\u0301", "22"]]
    lines = lay_out_table(Table(["name", "K"], rows, (), {}), 40, boxed=True)
    assert lines[3:5] == ["│ 網格 │  1 │", "│ e\u0301te\u0301  │ 22 │"]


@pytest.mark.parametrize(
    ("text", "width", "wanted"),
    [
        ("one two three", 7, ["one two", "three"]),
        ("metis:ufactor=30,contig=true", 12, ["metis:", "ufactor=30,", "contig=true"]),
        ("from 1,234,567 to -1e-3", 8, ["from", "1,234,567", "to -1e-3"]),
        ("a\n\nb", 5, ["a", "", "b"]),
        ("", 5, [""]),
    ],
)
def test_words_are_folded(text: str, width: int, wanted: list[str]) -> None:
    assert list(fold_text(text, width)) == wanted
