"""Solves in another numbering of the cells: nobody can tell but by the time they take."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.sparse.linalg import cg

from agglo_core import Hierarchy, Mesh, agglomerate, samples
from agglo_core.arrays import trusted_copy
from agglo_core.conformance.inputs.mesh_changes import renumber_mesh
from agglo_core.errors import AggloError
from agglo_core.graph.ordering import curve_order
from agglo_core.problems import Diffusion, Linear, Solution
from agglo_core.problems.solution import Deferred
from agglo_polydg_mg.solver import numbering
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

SEED = 20261122


def bare(mesh: Mesh) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, [], [], nested=True)


def scattered(mesh: Mesh) -> Mesh:
    """The mesh in random order, with the side of the unit square that a face of the boundary is on as tag."""
    there = renumber_mesh(mesh, SEED)[0]
    middle = there.points[there.face_pairs].mean(axis=1)
    side = np.select([middle[:, 0] < 1e-6, middle[:, 0] > 1 - 1e-6, middle[:, 1] < 1e-6], [1, 2, 3], 4)
    return replace(there, face_tags={"boundary": side, "walls": side % 2})


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return scattered(samples.voronoi(300, seed=SEED))


@pytest.fixture
def solve(monkeypatch) -> Callable[..., tuple[Solution, Solution]]:
    """Solve in the numbering of the mesh, and along the curve however few cells there are."""

    def both(problem: Diffusion, hierarchy: Hierarchy, **options: Any) -> tuple[Solution, Solution]:
        tool = PolyDGMultigrid(tolerance=1e-11, **options)
        plain = tool.solve(problem, hierarchy)
        monkeypatch.setattr(numbering, "FEW", {2: 1})
        other = tool.solve(problem, hierarchy)
        monkeypatch.undo()
        assert ["along a curve" in each.choice for each in (plain, other)] == [False, True]
        return plain, other

    return both


def require_near(one: Any, two: Any, bound: float = 1e-10) -> None:
    """Arrays or sparse matrices are the same but for so much of the largest entry."""
    assert one.shape == two.shape
    assert one.dtype == two.dtype
    assert abs(one - two).max() <= bound * abs(one).max()


def require_same(plain: Solution, other: Solution, bound: float = 1e-10) -> None:
    """x, b, A, and what was lifted are the same but for rounding, and for quadrature if it is not exact."""
    assert plain.converged
    assert other.converged
    require_near(plain.x, other.x, max(bound, 1e-8))
    require_near(plain.b, other.b, bound)
    require_near(plain.A, other.A, bound)
    for name in ("indices", "indptr", "blocksize"):
        assert np.array_equal(getattr(plain.A, name), getattr(other.A, name)), name
    (A, P), (B, Q) = plain.operators[0], other.operators[0]
    require_near(A, B, 1e-6)  # perhaps of single precision
    assert np.shape(P)[:1] == np.shape(Q)[:1]
    assert (plain.lifting is None) == (other.lifting is None)
    if plain.lifting is not None:
        for name in ("offset", "rest", "load"):
            require_near(getattr(plain.lifting, name), getattr(other.lifting, name), max(bound, 1e-8))


def problems(mesh: Mesh) -> dict[str, Diffusion]:
    """Data of all forms."""
    rng = np.random.default_rng(SEED)
    cells = rng.uniform(1.0, 2.0, mesh.n_cells)

    def wavy(points):
        return 2.0 + np.sin(7.0 * points[:, 0]) * np.cos(5.0 * points[:, 1])

    return {
        "numbers": Diffusion(2.0, 8.0),
        "kappa of cells": Diffusion(10.0 ** rng.uniform(-3, 3, mesh.n_cells)),
        "callables": Diffusion(wavy, wavy),
        "source of cells, as a list": Diffusion(1.0, (1e3 * rng.random(mesh.n_cells)).tolist()),
        "lifted": Diffusion(cells, 0.1, {1: 1000.0, 2: cells + 1000.0, 4: lambda p: 1000.0 + wavy(p)}),
        "fluxes": Diffusion(cells, wavy, {1: cells}, {2: 3.0, 3: wavy, 4: rng.random(mesh.n_cells)}),
        "another tag": Diffusion(1.0, cells, {0: 1.0}, {1: cells}, boundary="walls"),
        "tiny": Diffusion(1.0, 1e-200 * cells),
    }


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("name", problems(samples.squares(1)))
def test_data_of_all_forms(solve, mesh: Mesh, name: str, degree: int) -> None:
    solutions = solve(problems(mesh)[name], bare(mesh), degree=degree)
    require_same(*solutions, 1e-6 if name in ("callables", "lifted", "fluxes") else 1e-10)


@pytest.mark.parametrize("recipe", ["conforming", "patches"])
def test_given_levels_and_levels_made_here(solve, mesh: Mesh, recipe: str) -> None:
    problem = problems(mesh)["kappa of cells"]
    given = agglomerate(mesh, cells_per_part=(8, 64), nested=True)
    require_same(*solve(problem, given, recipe=recipe))
    require_same(*solve(problem, bare(mesh), recipe=recipe, levels=2))


def test_components_of_the_domain(solve) -> None:
    parts = renumber_mesh(samples.disconnected(14), SEED)[0]
    require_same(*solve(Diffusion(np.random.default_rng(SEED).uniform(1, 9, parts.n_cells)), bare(parts)))


def test_steps_renumber_once(monkeypatch, mesh: Mesh) -> None:
    monkeypatch.setattr(numbering, "FEW", {2: 1})
    orders = []
    monkeypatch.setattr(numbering, "curve_order", lambda x: orders.append(1) or curve_order(x))
    tool, rng = PolyDGMultigrid(degree=2, tolerance=1e-11), np.random.default_rng(SEED)
    steps, kappa, before = tool.repeated(bare(mesh)), rng.uniform(1, 2, mesh.n_cells), 0.0
    for k in range(4):
        problem = Diffusion(kappa * (1 + 0.1 * k), rng.random(mesh.n_cells) + before)
        found = steps.solve(problem)
        monkeypatch.setattr(numbering, "FEW", {2: mesh.n_cells + 1})
        plain = tool.solve(problem, bare(mesh))
        monkeypatch.setattr(numbering, "FEW", {2: 1})
        assert np.abs(found.x - plain.x).max() <= 1e-8 * np.abs(plain.x).max()
        assert abs(found.A - plain.A).max() <= 1e-11 * abs(plain.A).max()
        assert found.operators[0][0].shape == plain.A.shape
    assert (len(orders), steps.setups) == (1, 1)


def test_a_linear_system_between_steps_keeps_nothing_of_another_numbering(monkeypatch, mesh: Mesh) -> None:
    monkeypatch.setattr(numbering, "FEW", {2: 1})
    problem = problems(mesh)["kappa of cells"]
    steps = PolyDGMultigrid(tolerance=1e-10).repeated(bare(mesh))
    first = steps.solve(problem)
    system = Linear(first.A, first.b, 3 * np.arange(mesh.n_cells + 1))
    for each in (system, problem):
        again = steps.solve(each)
        assert len(again.residuals) == again.iterations + 1
        require_near(first.x, again.x, 1e-7)
    assert steps.setups == 3


def test_preconditioner_and_prolongation_take_the_users_numbers(monkeypatch, mesh: Mesh) -> None:
    monkeypatch.setattr(numbering, "FEW", {2: 1})
    problem, tool = problems(mesh)["kappa of cells"], PolyDGMultigrid(degree=1)
    cells = curve_order(mesh.graph.centroids)
    here = replace(problem, kappa=problem.kappa[cells])
    M = tool.aspreconditioner(problem, bare(mesh))
    there = tool.aspreconditioner(here, bare(mesh.renumbered(cells)))
    r = np.random.default_rng(SEED).random((M.shape[0], 2))
    rows = (3 * cells[:, None] + np.arange(3)).ravel()
    assert np.array_equal((M @ r)[rows], there @ r[rows])
    found = tool.solve(problem, bare(mesh))
    x, failed = cg(found.A, found.b, M=M, rtol=1e-10, maxiter=40)
    assert not failed
    assert np.linalg.norm(found.A @ x - found.b) <= 1e-9 * np.linalg.norm(found.b)
    P, same = (
        tool.solve(*each).operators[0][1]
        for each in [(problem, bare(mesh)), (here, bare(mesh.renumbered(cells)))]
    )
    assert abs(P[rows] - same).max() == 0


def test_matrices_are_assembled_on_first_access(monkeypatch, mesh: Mesh) -> None:
    monkeypatch.setattr(numbering, "FEW", {2: 1})
    found = PolyDGMultigrid().solve(Diffusion(), bare(mesh))
    assert isinstance(vars(found)["A"], Deferred)
    assert isinstance(vars(found)["operators"], Deferred)
    copied = pickle.loads(pickle.dumps(found))
    assert abs(copied.A - found.A).max() == 0
    assert vars(found)["A"] is found.A
    assert found.operators is found.operators


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda n: {"kappa": np.where(np.arange(n) == 77, -1.0, 1.0)}, "-1.0 in cell 77"),
        (lambda n: {"kappa": np.ones(n + 1)}, "kappa has shape"),
        (lambda n: {"source": [[1.0], [1.0, 2.0]]}, "source must be an array of numbers"),
        (lambda n: {"neumann": {1: 1.0}}, "the component of cell 0 "),
        (lambda n: {"dirichlet": {9: 1.0}}, "no boundary face has the tag 9"),
    ],
)
def test_errors_name_the_users_cells(monkeypatch, mesh: Mesh, change, said: str) -> None:
    monkeypatch.setattr(numbering, "FEW", {2: 1})
    with pytest.raises(AggloError, match=said):
        PolyDGMultigrid().solve(Diffusion(**change(mesh.n_cells)), bare(mesh))


def test_a_hierarchy_of_another_mesh_is_refused(monkeypatch, mesh: Mesh) -> None:
    monkeypatch.setattr(numbering, "FEW", {2: 1})
    for other in (samples.squares(20), renumber_mesh(mesh, 3)[0]):
        with pytest.raises(AggloError, match="belongs to another mesh"):
            PolyDGMultigrid().solve(Diffusion(), trusted_copy(bare(mesh), fine=other))


@pytest.mark.parametrize("make", [lambda: samples.squares(20), lambda: samples.triangles(12)])
def test_orderly_meshes_keep_their_numbers(monkeypatch, make) -> None:
    monkeypatch.setattr(numbering, "FEW", {2: 1})
    assert numbering.numbering_for(bare(make())).cells is None


def test_few_cells_keep_their_numbers_and_many_do_not(mesh: Mesh) -> None:
    assert numbering.numbering_for(bare(mesh)).cells is None
    many = samples.voronoi(11_000, seed=SEED)
    found = PolyDGMultigrid().solve(Diffusion(), bare(many))
    assert found.converged
    assert "along a curve" in found.choice
    assert np.linalg.norm(found.A @ found.x - found.b) <= 1e-5 * np.linalg.norm(found.b)
