"""What polydg_mg and direct say of each other: where, for whom, and how to choose the other one."""

from __future__ import annotations

import re

import numpy as np
import pytest
from command_line import Agglo
from flux_matrices import nearly_incompressible, two_point_flux
from scipy import sparse

from agglo_core import Hierarchy, Mesh, samples
from agglo_core.cli.options.specs import parse_spec
from agglo_core.problems import Diffusion, Elasticity, Linear, Problem
from agglo_core.registry import default
from agglo_core.solvers import advice
from agglo_core.solvers.advice import MANY, advice_of_components, advice_of_direct, advice_of_multigrid
from agglo_core.solvers.direct import Direct
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

KINDS = ("cells", "groups", "linear")
SOURCE = Diffusion(source=8.0)


class Sized:
    """A matrix of so many entries, ten in a row."""

    def __init__(self, entries: float) -> None:
        self.nnz, self.shape = int(entries), (int(entries) // 10, int(entries) // 10)


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> tuple[str, ...]:
    """Direct solvers taken to be installed."""
    names: tuple[str, ...] = request.param
    monkeypatch.setattr(advice, "available_backends", lambda: names)
    monkeypatch.setattr(advice, "choose_backend", lambda _: names[0])
    return names


def bare(mesh: Mesh) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, [], [], nested=True)


with_all = pytest.mark.parametrize(
    "installed", [("pardiso", "cholmod", "superlu"), ("cholmod", "superlu"), ("superlu",)], indirect=True
)


@with_all
@pytest.mark.parametrize("kind", KINDS)
def test_small_systems_are_for_direct_solvers_and_large_ones_for_multigrid(
    installed: tuple[str, ...], kind: advice.Kind
) -> None:
    fastest = "PARDISO" if "pardiso" in installed else "SuperLU"
    assert f"{fastest} usually takes less time up to about" in advice_of_multigrid(Sized(1e4), kind)
    assert advice_of_multigrid(Sized(1e9), kind) == advice_of_multigrid(Sized(1e9), "linear", MANY) == ""
    assert advice_of_direct(Sized(1e4), kind, "superlu") == ""
    back = advice_of_direct(Sized(1e9), kind, "superlu")
    assert ("use the solver polydg_mg" in back) == (kind != "linear")
    for entries in np.geomspace(1e3, 1e9, 50):
        both = advice_of_multigrid(Sized(entries), kind), advice_of_direct(Sized(entries), kind, "superlu")
        assert "" in both or "PARDISO usually" in both[0], "each sends the user to the other"
        for text in filter(None, both):
            name, options = parse_spec(re.search(r"use the solver ([^ ;]+)", text)[1])
            assert default().build("solver", name, **options)


@pytest.mark.parametrize("problem", [SOURCE, Elasticity(force=(0.0, -1.0))])
def test_after_a_failure_it_names_the_call_that_solves(problem: Problem) -> None:
    mesh = samples.voronoi(60, seed=1)
    failed = PolyDGMultigrid(degree=2, max_iterations=1).solve(problem, bare(mesh))
    assert not failed.converged
    assert "did not converge" in failed.advice
    name, options = parse_spec(failed.advice.rsplit(" ", 1)[1])
    exact = default().build("solver", name, **options).solve(problem, bare(mesh))
    solved = PolyDGMultigrid(degree=2, tolerance=1e-10).solve(problem, bare(mesh))
    assert "did not converge" not in solved.advice
    points = mesh.cell_centroids
    assert exact.evaluate(points) == pytest.approx(solved.evaluate(points), rel=1e-6, abs=1e-9)


@with_all
def test_the_advice_names_the_available_backend(installed: tuple[str, ...]) -> None:
    said = advice_of_multigrid(Sized(1e4), "cells", 1, "sharp")
    other = ",backend=superlu" if installed[0] == "cholmod" else ""
    assert f"use the solver direct:penalty=sharp{other}" in said
    assert ("PARDISO is not installed" in said) == ("pardiso" not in installed)
    assert "use the solver direct;" in f"{advice_of_multigrid(Sized(8e4), 'groups', 1, 10.0)};" or other
    many = advice_of_multigrid(Sized(1.5e5), "linear", MANY)
    assert advice_of_multigrid(Sized(1.5e5), "linear") == ""
    assert ("PARDISO" if "pardiso" in installed else "SuperLU") in many.split()[0]
    assert "with 10 right-hand sides" in many
    assert "for the inverse of all columns use aspreconditioner of the solver direct" in many


@pytest.mark.parametrize("installed", [("superlu",)], indirect=True)
def test_solutions_carry_advice(installed: tuple[str, ...]) -> None:
    mesh = samples.voronoi(60, seed=2)
    solution = PolyDGMultigrid(2).solve(SOURCE, bare(mesh))
    limit = advice._ONE["superlu", "groups"].most * len(solution.x) / solution.A.nnz
    said = float(re.search(r"up to about ([\d,]+) unknowns", solution.advice)[1].replace(",", ""))
    assert said == pytest.approx(limit, rel=0.05)
    assert "use the solver direct:penalty=sharp;" in solution.advice
    assert Direct().solve(SOURCE, bare(mesh)).advice == ""
    steps = PolyDGMultigrid().repeated(bare(mesh))
    assert steps.solve(SOURCE).advice
    assert steps.solve(SOURCE).advice == ""  # levels are there already


def test_direct_solvers_send_large_systems_to_multigrid(monkeypatch: pytest.MonkeyPatch) -> None:
    others = {"cells": 100, "groups": 1e9, "linear": 100}
    limits = {("superlu", kind): advice._Range(0.0, 0.0, other) for kind, other in others.items()}
    monkeypatch.setattr(advice, "_ONE", limits)
    squares, cells = samples.squares(6), samples.voronoi(60, seed=2)
    direct = Direct(2, backend="superlu")
    assert (
        "multigrid usually takes less time than SuperLU from about"
        in direct.solve(SOURCE, bare(squares)).advice
    )
    assert direct.solve(SOURCE, bare(cells)).advice == ""  # vertex patches cost more
    A = two_point_flux(cells, np.ones(60))
    linear = Linear(A, np.ones(60), np.arange(61))
    assert "use the solver polydg_mg" in direct.solve(linear, bare(cells)).advice


@pytest.mark.parametrize("installed", [("superlu",)], indirect=True)
def test_systems_that_direct_does_not_take_get_no_advice(installed: tuple[str, ...]) -> None:
    mesh = samples.squares(4)
    A = sparse.diags_array(np.linspace(1.0, 2.0, 18)).tocsr()
    uneven = np.concatenate(([0, 3], np.arange(4, 19)))
    assert PolyDGMultigrid().solve(Linear(A, np.ones(18), uneven), bare(mesh)).advice == ""
    even = Linear(A[:16, :16], np.ones((16, 12)), np.arange(17))
    assert "with 12 right-hand sides" in PolyDGMultigrid().solve(even, bare(mesh)).advice
    one = Linear(even.A, even.b[:, 0], even.block_offsets)
    inverse = Direct().aspreconditioner(one, bare(mesh))  # what it says
    np.testing.assert_allclose(even.A @ (inverse @ even.b), even.b)


def test_the_command_prints_the_advice(agglo: Agglo) -> None:
    done = agglo("solve", "squares:n=8", "--no-cg")
    data = agglo("solve", "squares:n=8", "--no-cg", "--json").data
    assert f"advice: {data['advice']}" in " ".join(done.out.split())
    assert "use the solver direct:penalty=sharp" in data["advice"]
    chosen = re.search(r"use the solver ([^ ;]+)", data["advice"])[1]
    assert agglo("solve", "squares:n=8", "--no-cg", "--solver", chosen).code == 0


@pytest.mark.parametrize("ratio", [1.0, 1000.0])
def test_nearly_incompressible_systems_are_named(ratio: float) -> None:
    mesh = samples.squares(30)
    problem = Linear(nearly_incompressible(30, ratio), np.sin(np.arange(1800.0)), 2)
    found = PolyDGMultigrid().solve(problem, bare(mesh))
    assert ("nearly incompressible elasticity" in found.advice) == (ratio > 1.0)
    assert (found.iterations > 60) == (ratio > 1.0)


def test_slow_systems_of_polynomials_are_not_taken_for_elasticity() -> None:
    """Mean and slopes cancel as well, but no constant slope is a near-null vector."""
    mesh = samples.voronoi(300, seed=5)
    system = PolyDG(1).assemble(SOURCE, mesh)
    identity = np.asarray(system.A.diagonal())
    assert advice_of_components(system.A, sparse.diags_array(0.2 / identity), 3) == ""


@pytest.mark.parametrize("installed", [("pardiso", "superlu")], indirect=True)
@pytest.mark.usefixtures("installed")
def test_plane_systems_up_to_twenty_thousand_unknowns_are_for_pardiso() -> None:
    mesh = samples.squares(130)
    problem = Linear(two_point_flux(mesh, np.ones(mesh.n_cells)), np.ones(mesh.n_cells))
    advice_of_plane = PolyDGMultigrid().solve(problem, bare(mesh)).advice
    assert re.search(r"PARDISO usually takes less time up to about 2\d,000 unknowns", advice_of_plane)
    assert (
        PolyDGMultigrid()
        .solve(problem, Hierarchy(None, mesh.graph, [], [], nested=True))
        .advice.startswith("SuperLU")
    )
    assert advice_of_multigrid(Sized(5e5), "plane blocks") != advice_of_multigrid(Sized(5e5), "plane") == ""
