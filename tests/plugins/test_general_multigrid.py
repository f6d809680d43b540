"""The default solver for linear systems whose matrix need not be symmetric."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from flux_matrices import upwind_flux
from scipy import sparse
from scipy.sparse.linalg import spsolve

import agglo_core as agglo
from agglo_core import Mesh, OptionError, agglomerate, samples
from agglo_core.arrays import Float
from agglo_core.multigrid import cycle, flow_stack
from agglo_core.problems import Diffusion, Linear, System
from agglo_polydg_mg.polydg import PolyDG
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid


def east(x: Float) -> Float:
    return np.broadcast_to([1.0, 0.3, -0.2][: x.shape[1]], x.shape)


def swirl(x: Float) -> Float:
    found = np.zeros(x.shape)
    found[:, 0], found[:, 1] = 0.5 - x[:, 1], x[:, 0] - 0.5
    return found


@pytest.mark.parametrize("peclet", [0.1, 1.0, 10.0, 1e2, 1e4])
@pytest.mark.parametrize(("velocity", "most"), [(east, 15), (swirl, 30)])
@pytest.mark.parametrize("mesh", [samples.squares(60), samples.voronoi(3000, seed=1), samples.boxes(16)])
def test_iterations_are_few_for_all_peclet_numbers(
    mesh: Mesh, velocity: Any, most: int, peclet: float
) -> None:
    A = upwind_flux(mesh, peclet, velocity)
    b = np.random.default_rng(0).standard_normal(mesh.n_cells)
    solution = agglo.solve(mesh, Linear(A, b, symmetric=False))
    assert solution.converged
    assert solution.iterations <= most
    assert np.linalg.norm(b - A @ solution.x) <= 1.1e-6 * np.linalg.norm(b)
    assert solution.energy_error is None
    assert solution.tests == ("residual",)
    assert solution.advice == ""
    assert len(solution.levels) >= 2


@pytest.mark.parametrize("unknowns", [1, 3, [2, 0, 1]])
@pytest.mark.parametrize("scale", [1.0, 1e180])
def test_solutions_equal_those_of_elimination(unknowns: Any, scale: float) -> None:
    mesh = samples.squares(20)
    sizes = np.resize(unknowns, mesh.n_cells)
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    rng = np.random.default_rng(1)
    n = int(offsets[-1])
    A = sparse.random_array((n, n), density=4 / n, rng=rng) + 6.0 * sparse.eye_array(n)
    A, b = sparse.csr_array(scale * A), rng.standard_normal((n, 2))
    solution = agglo.solve(mesh, Linear(A, b, offsets, symmetric=False), tolerance=1e-10)
    assert solution.converged
    assert [each.converged for each in solution.columns] == [True, True]
    exact = spsolve(sparse.csc_array(A / scale), b) / scale
    assert solution.x == pytest.approx(exact, rel=1e-6, abs=1e-7 * np.abs(exact).max())


@pytest.mark.parametrize("dependent", [False, True])
def test_blocks_carry_near_null_vectors_to_coarse_levels(dependent: bool) -> None:
    mesh = samples.voronoi(3000, seed=2)
    A = sparse.csr_array(sparse.kron(upwind_flux(mesh, 10.0, east), [[2.0, -1.0], [-1.0, 2.0]]))
    null = np.tile(np.eye(2), (mesh.n_cells, 1))
    if dependent:
        null = np.column_stack((null, null.sum(axis=1)))
    stack = flow_stack(System(A, np.zeros(A.shape[0]), 2, None, null, symmetric=False))
    coarse = null
    for level, below in zip(stack.levels, stack.levels[1:], strict=False):
        coarse = level.P.T @ coarse
        assert below.A.shape == (len(coarse), len(coarse))
    for level in stack.levels[-2::-1]:
        coarse = level.P @ coarse
    assert coarse == pytest.approx(null, abs=1e-12)
    assert np.isfinite(cycle(stack, "W") @ np.ones(A.shape[0])).all()
    problem = Linear(A, np.ones(A.shape[0]), 2, null, symmetric=False)
    assert agglo.solve(mesh, problem).iterations <= 12


def test_a_discretised_problem_is_solved_from_its_matrix() -> None:
    mesh = samples.voronoi(1500, seed=3)
    system = PolyDG(1).assemble(Diffusion(1e-2, convection=east), mesh)
    solution = agglo.solve(mesh, Linear(system.A, system.b, 3, symmetric=False))
    assert solution.converged
    assert "blocks downstream" in solution.choice


def test_failures_refer_to_direct() -> None:
    mesh = samples.squares(50)
    diffusion, upwind = (upwind_flux(mesh, 20.0, flow) for flow in (np.zeros_like, swirl))
    central = diffusion + 0.5 * ((upwind - diffusion) - (upwind - diffusion).T)
    hierarchy = agglomerate(mesh, n_parts=9, polish=False)
    solution = agglo.solve(hierarchy, Linear(central, np.ones(2500), symmetric=False))
    assert not solution.converged
    assert "prevents a further decrease" in solution.reason or "not finite" in solution.reason
    assert solution.advice == "multigrid does not suit this matrix: use the solver direct"
    singular = sparse.csr_array(np.eye(2500, k=1))
    failed = agglo.solve(hierarchy, Linear(singular, np.ones(2500), symmetric=False))
    assert not failed.converged
    assert "use the solver direct" in failed.reason
    assert not failed.x.any()


@pytest.mark.parametrize("name", ["recipe=agglomerates", "recipe=patches", "cycle=K", "precision=single"])
def test_options_for_symmetric_matrices_are_refused(name: str) -> None:
    key, value = name.split("=")
    hierarchy = agglomerate(samples.squares(4), n_parts=4)
    problem = Linear(np.eye(16), np.ones(16), symmetric=False)
    with pytest.raises(OptionError, match=f"{key} '{value}' requires a symmetric matrix, but the system has"):
        agglo.solve(hierarchy, problem, **{key: value})
    with pytest.raises(OptionError, match="symmetric=False, so its matrix is not symmetric, but aspr"):
        PolyDGMultigrid().aspreconditioner(problem, hierarchy)


def test_levels_are_reused_for_equal_systems() -> None:
    mesh = samples.voronoi(3000, seed=4)
    steps = PolyDGMultigrid(tolerance=1e-9).repeated(agglomerate(mesh, n_parts=300, polish=False))
    A = upwind_flux(mesh, 10.0, swirl)
    for k in range(3):
        b = np.cos(k * mesh.cell_centroids[:, 0])
        found = steps.solve(Linear(A, b, symmetric=False))
        assert found.converged
        assert found.x == pytest.approx(spsolve(sparse.csc_array(A), b), rel=1e-5, abs=1e-7)
    assert steps.setups == 1
