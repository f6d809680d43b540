"""agglo-borders, a distribution with a component for each border: listed, used by each command, checked."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
from thirdparty.installing import Answer, converse, environment

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent / "agglo-borders"
FILES = sorted((HERE / "agglo_borders").glob("*.py"))
DECLARED = {
    "format": "toy",
    "sample": "cross",
    "problem": "heat",
    "solver": "cells_cg",
    "smoother": "two_sweeps",
    "metric": "crowding",
    "constraint": "apart",
    "section": "sizes",
}
HEAT = 'kind = "heat"\nsource = 2.0\nloss = 0.5\n'
COMMANDS = {
    "listing": "plugins --json",
    "mesh": "mesh cross:n=3 -o x.toy",
    "wrong option": "mesh cross:n=none -o y.toy",
    "not held": "mesh boxes:n=2 -o boxes.toy",
    "report": "run x.toy --metrics UF,crowding --report r.html --constraint apart:tag=arm --parts 6 --json",
    "no tag": "run x.toy --constraint apart:tag=leg --parts 6",
    "objective": "run x.toy --metrics crowding --post-refiner descent:objective=crowding --parts 6 --json",
    "plain": "run x.toy --metrics crowding --parts 6 --json",
    "solve": "solve squares:n=8 --solver cells_cg --problem heat.toml --json",
    "other solver": "solve squares:n=8 --solver polydg_cg --problem heat.toml",
    "smoother": "solve squares:n=8 --solver polydg_mg_paper:smoother=two_sweeps --json",
    **{f"check {kind}": f"check {kind}:{name} --json" for kind, name in DECLARED.items()},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the commands are given: a broken file and a problem are there already."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "heat.toml").write_text(HEAT)
    return folder


@pytest.fixture(scope="module")
def answers(borders: Path, folder: Path) -> Mapping[str, Answer]:
    """What agglo answered to each of the commands, all given in one interpreter."""
    given = converse(borders, [each.split() for each in COMMANDS.values()], folder)
    return dict(zip(COMMANDS, given, strict=True))


def level(answer: Answer) -> dict[str, float]:
    """The only level of the only run."""
    assert answer.code == 0, answer.err
    (run,) = json.loads(answer.out)["runs"]
    (only,) = run["levels"]
    return dict(only)


def test_each_file_is_short_and_imports_the_authors_names_alone() -> None:
    assert len(FILES) == len(DECLARED) + 1
    for file in FILES:
        tree = ast.parse(file.read_text())
        modules = {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert {name for name in modules if name.startswith("agglo_core")} == {"agglo_core.authoring"}
        if file.stem != "__init__":
            assert lines_of_code(tree) <= 25, file.name


def lines_of_code(tree: ast.Module) -> int:
    """Lines that hold a statement: no blank lines, docstrings, imports of the future, ``__all__``."""
    lines = set[int]()
    for node in ast.walk(tree):
        doc = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        future = isinstance(node, ast.ImportFrom) and node.module == "__future__"
        listed = isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        if isinstance(node, ast.stmt) and not (doc or future or listed):
            block = getattr(node, "body", None)
            lines |= set(range(node.lineno, (block[0].lineno if block else node.end_lineno + 1)))
    return len(lines)


def test_the_plugin_is_discovered_and_listed(answers: Mapping[str, Answer]) -> None:
    records = [each for each in json.loads(answers["listing"].out) if each["plugin"] == "borders"]
    assert {each["kind"]: each["name"] for each in records} == DECLARED
    origins = {(each["state"], each["distribution"], each["version"]) for each in records}
    assert origins == {("ok", "agglo-borders", "0.2.0")}


def test_its_sample_is_written_in_its_format(answers: Mapping[str, Answer], folder: Path) -> None:
    assert answers["mesh"].code == 0, answers["mesh"].err
    found = json.loads((folder / "x.toy").read_text())
    assert (len(found["cells"]), sum(found["tags"]["arm"])) == (45, 27)


def test_what_does_not_fit_is_refused_in_one_line(answers: Mapping[str, Answer], folder: Path) -> None:
    assert answers["wrong option"].code == answers["not held"].code == answers["no tag"].code == 2
    assert "n of sample 'cross'" in answers["wrong option"].err
    assert "distribution agglo-borders 0.2.0" in answers["wrong option"].err
    assert "a toy file holds cells of the plane" in answers["not held"].err
    assert "no cell tag is named 'leg'; there are arm" in answers["no tag"].err
    assert not list(folder.glob("boxes*"))


def test_its_constraint_metric_and_section_take_part_in_a_run(
    answers: Mapping[str, Answer], folder: Path
) -> None:
    values = level(answers["report"])
    assert (values["parts"], values["connected"]) == (6, 1.0)
    assert values["crowding"] >= 45**2 / 6**2
    page = (folder / "r.html").read_text()
    assert "Parts of every level" in page
    assert "6 parts</li>" in page


def test_its_metric_is_pursued_by_a_refiner(answers: Mapping[str, Answer]) -> None:
    assert level(answers["objective"])["crowding"] <= level(answers["plain"])["crowding"]


def test_its_solver_takes_its_problem_and_no_other_does(answers: Mapping[str, Answer]) -> None:
    assert answers["solve"].code == 0, answers["solve"].err
    assert json.loads(answers["solve"].out)["converged"] is True
    assert answers["other solver"].code == 2
    assert "heat" in answers["other solver"].err


def test_its_smoother_serves_our_multigrid(answers: Mapping[str, Answer]) -> None:
    assert answers["smoother"].code == 0, answers["smoother"].err
    result = json.loads(answers["smoother"].out)
    assert result["converged"] is True
    assert result["iterations"] < 30


@pytest.mark.parametrize("kind", DECLARED)
def test_the_command_line_checks_it(answers: Mapping[str, Answer], kind: str) -> None:
    answer = answers[f"check {kind}"]
    results = json.loads(answer.out)
    assert [result["message"] for result in results if not result["passed"]] == []
    assert len(results) >= 7
    assert answer.code == 0


def test_its_own_tests_pass_away_from_the_source_tree(borders: Path, tmp_path: Path) -> None:
    """One law of each component; the command line has checked all of them."""
    shutil.copy(HERE / "tests/test_conformance.py", tmp_path)
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-v",
            "-k",
            "is_found",
            "-p",
            "no:cacheprovider",
            "--rootdir",
            str(tmp_path),
        ],
        capture_output=True,
        text=True,
        env=environment(borders),
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    for name in DECLARED.values():
        assert f"test_{name}[is_found] PASSED" in done.stdout
