"""agglo-hilbert, a distribution of its own: installed, discovered, listed, run, measured, checked."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import pytest
from thirdparty.installing import Answer, converse, environment

pytestmark = pytest.mark.slow

COMMANDS = {
    "listing": "plugins --json",
    "help": "--help",
    "run": "run squares:n=8 --bisector hilbert --refiner leaves --parts 16 --json",
    "options": "run squares:n=8 --bisector hilbert:bits=3 --refiner leaves:sweeps=2 --parts 16 --json",
    "qualified": "run squares:n=8 --bisector hilbert/hilbert --parts 16 --json",
    "solid": "run boxes:n=4 --bisector hilbert --parts 8 --json",
    "unknown option": "run squares:n=8 --bisector hilbert:bit=3 --parts 16",
    "wrong option": "run squares:n=8 --bisector hilbert:bits=21 --parts 16",
    "command": "hilbert-order squares:n=4 --bits 2",
    "help of command": "hilbert-order --help",
    "wrong sample": "hilbert-order sqares",
    "check": "check hilbert --json",
}


@pytest.fixture(scope="module")
def answers(hilbert: Path, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Answer]:
    """What agglo answered to each of the commands, all given in one interpreter."""
    folder = tmp_path_factory.mktemp("work")
    given = converse(hilbert, [each.split() for each in COMMANDS.values()], folder)
    return dict(zip(COMMANDS, given, strict=True))


def test_the_plugin_is_discovered_and_listed(answers: Mapping[str, Answer]) -> None:
    records = [each for each in json.loads(answers["listing"].out) if each["plugin"] == "hilbert"]
    assert [(each["kind"], each["name"]) for each in records] == [
        ("bisector", "hilbert"),
        ("refiner", "leaves"),
        ("metric", "gyration"),
        ("command", "hilbert-order"),
    ]
    origins = {(each["state"], each["distribution"], each["version"]) for each in records}
    assert origins == {("ok", "agglo-hilbert", "0.4.2")}
    assert "hilbert-order  Print the cells of a sample along the curve." in answers["help"].out


@pytest.mark.parametrize("run", ["run", "options", "qualified"])
def test_the_bisector_runs_from_the_command_line(answers: Mapping[str, Answer], run: str) -> None:
    (result,) = json.loads(answers[run].out)["runs"]
    (level,) = result["levels"]
    assert (level["parts"], level["connected"], level["UF"]) == (16, 1.0, 1.0)  # squares of 2 × 2 cells
    assert level["CR"] == pytest.approx(2**-0.5)


def test_the_bisector_runs_in_3d(answers: Mapping[str, Answer]) -> None:
    (level,) = json.loads(answers["solid"].out)["runs"][0]["levels"]
    assert (level["parts"], level["connected"]) == (8, 1.0)
    assert level["max_diameter"] == pytest.approx(3**0.5 / 2)  # cubes of 2 × 2 × 2 cells


def test_its_options_are_checked(answers: Mapping[str, Answer]) -> None:
    unknown, wrong = answers["unknown option"], answers["wrong option"]
    assert (unknown.code, wrong.code) == (2, 2)
    assert "distribution agglo-hilbert 0.4.2) has no option 'bit' (did you mean 'bits'?)" in unknown.err
    assert "hilbert: bits must be an integer in 1..20, given 21" in wrong.err


def test_its_command_runs(answers: Mapping[str, Answer]) -> None:
    order = [int(cell) for cell in answers["command"].out.split()]
    assert sorted(order) == list(range(16))
    steps = [abs(a % 4 - b % 4) + abs(a // 4 - b // 4) for a, b in pairwise(order)]
    assert steps == [1] * 15  # the curve goes from neighbour to neighbour
    assert "--bits" in answers["help of command"].out
    assert answers["wrong sample"].code == 2
    assert "sqares" in answers["wrong sample"].err


def test_its_metric_is_one_of_all(hilbert: Path) -> None:
    source = """
import agglo_core as agglo

mesh = agglo.samples.squares(4)
print(dict(agglo.quality(mesh, [0] * 16, metrics=("gyration", "cells"))))
print(agglo.quality(mesh, range(16), metrics=[("hilbert/gyration", {})])["hilbert/gyration"].max())
"""
    done = subprocess.run(
        [sys.executable, "-c", source], capture_output=True, text=True, env=environment(hilbert), check=True
    )
    # centroids ±1/8, ±3/8: mean square 10/64 · 1/2 in each direction, over a diameter √2
    values, single = done.stdout.splitlines()
    assert values == "{'gyration': array([0.2795085]), 'cells': array([16.])}"
    assert float(single) == pytest.approx(0, abs=1e-12)


def test_the_command_line_checks_it(answers: Mapping[str, Answer]) -> None:
    results = json.loads(answers["check"].out)
    assert [result["message"] for result in results if not result["passed"]] == []
    assert {"deterministic", "3d", "pickles"} <= {result["promise"] for result in results}
    assert "a_level_is_its_blocks" in {result["law"] for result in results}
    assert answers["check"].code == 0


def test_its_own_tests_pass_away_from_the_source_tree(hilbert: Path, tmp_path: Path) -> None:
    """All laws of the refiner and the metric; the command line has checked the bisector."""
    shutil.copy(Path(__file__).parent / "agglo-hilbert/tests/test_conformance.py", tmp_path)
    chosen = "leaves or gyration or is_found or answers"
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-v",
            "-k",
            chosen,
            "-p",
            "no:cacheprovider",
            "--rootdir",
            str(tmp_path),
        ],
        capture_output=True,
        text=True,
        env=environment(hilbert),
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    for name in "test_hilbert", "test_leaves", "test_gyration":
        assert f"{name}[is_found] PASSED" in done.stdout
        assert f"{name}[answers] PASSED" in done.stdout
