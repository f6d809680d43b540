"""``agglo compare --solve``: each hierarchy in a solver; what fails is a row."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cell_values import Fluxes
from command_line import Agglo

from agglo_core import Component, Hierarchy, MeshError, hookimpl
from agglo_core.problems import Diffusion, Solution
from agglo_core.registry import default

MANY = 20  # parts of the finest level, from which Picky refuses


class Picky(Fluxes):
    """Two-point fluxes, on few parts."""

    def solve(self, problem: Diffusion, hierarchy: Hierarchy) -> Solution:
        """Refuse a level of many parts."""
        if hierarchy.parts[0] > MANY:
            raise MeshError(f"{hierarchy.parts[0]} parts are too many for me")
        return super().solve(problem, hierarchy)


class Slices:
    """A bisector that always cuts off one cell in eight: more parts than others need."""

    def bisect(self, graph: object, rng: np.random.Generator) -> np.ndarray:
        """The first eighth, at least a cell, against the rest."""
        return (np.arange(graph.n) >= max(1, graph.n // 8)).astype(int)


@pytest.fixture(autouse=True)
def _strangers(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    home = SimpleNamespace(Picky=Picky, Slices=Slices)
    monkeypatch.setitem(__import__("sys").modules, "compare_solve_home", home)
    components = [
        Component("solver", "fluxes", "cell_values:Fluxes"),
        Component("solver", "picky", "compare_solve_home:Picky"),
        Component("bisector", "slices", "compare_solve_home:Slices"),
    ]
    default().register(SimpleNamespace(agglo_components=hookimpl(lambda: components)), "strangers")
    yield
    default().unregister("strangers")


def test_each_strategy_is_solved_as_agglo_solve_does(agglo: Agglo) -> None:
    pytest.importorskip("agglo_polydg_mg")
    asked = ("voronoi:n=120", "--parts", "20,5", "--problem", "sine", "--json")
    data = agglo(
        "compare", *asked, "--bisector", "kmeans,coordinate", "--solve", "polydg_mg_paper:degree=2"
    ).data
    assert (data["solver"], data["problem"]) == ("polydg_mg_paper:degree=2", "sine")
    assert [run["bisector"] for run in data["runs"]] == ["kmeans", "coordinate"]
    for run in data["runs"]:
        found = run["solve"]
        same = (*asked, "--bisector", run["bisector"], "--solver", "polydg_mg_paper:degree=2", "--no-cg")
        alone = agglo("solve", *same).data
        assert (found["iterations"], found["converged"]) == (alone["iterations"], True)
        fall = alone["residuals"][-1] / alone["residuals"][0]
        assert found["contraction"] == pytest.approx(fall ** (1 / alone["iterations"]))
        assert list(found["seconds"]) == ["hierarchy", "setup", "solve"]
        assert min(found["seconds"].values()) > 0.0
        assert found["error"] is None
    assert data["runs"][0]["solve"]["iterations"] != data["runs"][1]["solve"]["iterations"]


def test_a_failure_is_a_row(agglo: Agglo) -> None:
    asked = ("compare", "squares:n=8", "--bisector", "slices,kmeans", "--h-star", "0.5")
    done = agglo(*asked, "--solve", "picky")
    assert done.code == 3
    assert "parts are too many for me" in done.out
    runs = agglo(*asked, "--solve", "picky", "--json").data["runs"]
    assert "too many for me" in runs[0]["solve"]["error"]
    assert runs[0]["levels"] != []  # its shapes are known all the same
    assert runs[1]["solve"]["converged"]
    assert runs[1]["solve"]["seconds"]["setup"] is None  # Fluxes does not tell its phases


def test_what_does_not_converge_says_so(agglo: Agglo) -> None:
    done = agglo("compare", "squares:n=8", "--bisector", "kmeans", "--solve", "fluxes:most=2")
    assert done.code == 3
    assert "kmeans: not converged: residual" in done.out
    assert agglo("compare", "squares:n=8", "--bisector", "kmeans", "--solve", "fluxes").code == 0


def test_methods_that_are_not_implemented_have_a_row_and_no_blame(agglo: Agglo) -> None:
    asked = ("compare", "squares:n=8", "--bisector", "inertial,kmeans", "--method", "kway", "--parts", "16,4")
    done = agglo(*asked, "--solve", "fluxes")
    assert done.code == 0
    assert "converged" in done.out
    plain = agglo(*asked, "--json").data
    assert "solver" not in plain
    assert "solve" not in plain["runs"][1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["squares:n=4", "--problem", "sine"], "--problem needs --solve"),
        (["squares:n=4", "--solve", "nosuch"], "no solver is named 'nosuch'"),
        (["squares:n=4", "--solve", "fluxes:degree=2"], "has no option 'degree'"),
        (["boxes:n=2", "--solve", "fluxes"], "cell values are for the plane"),
        (["squares:n=4", "--solve", "fluxes", "--problem", "no.toml"], "no.toml: no such file"),
    ],
)
def test_what_cannot_be_solved_is_refused_first(agglo: Agglo, arguments: list[str], message: str) -> None:
    done = agglo("compare", *arguments)
    assert (done.code, done.out) == (2, "")
    assert message in done.err


def test_the_report_shows_what_was_solved(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = (
        "compare",
        "voronoi:n=100",
        "--bisector",
        "kmeans,coordinate",
        "--parts",
        "25",
        "--report",
        "r.html",
    )
    assert agglo(*asked).code == 0
    assert 'id="solve-title"' not in Path("r.html").read_text()
    assert agglo(*asked, "--solve", "fluxes").code == 0
    page = Path("r.html").read_text()
    assert page.index('id="solve-title"') < page.index("<canvas")
    for name in ("kmeans", "coordinate"):
        assert f"<summary>{name}</summary>" in page
    assert page.count('<th scope="row">hierarchy</th>') == 2

    def fail(*_: object) -> None:
        raise ZeroDivisionError("no norms")

    monkeypatch.setattr("cell_values.CellValues.errors", fail)
    assert agglo(*asked, "--solve", "fluxes").code == 0
    assert "no norms" in Path("r.html").read_text()
