"""What solvers call converged is right in the energy norm, checked by elimination on random problems."""

from __future__ import annotations

from copy import copy

import numpy as np
import pytest
from random_diffusion import Case, energy_error, graded, random_case, with_four_sides
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core import agglomerate, samples
from agglo_core.problems import Diffusion, Solution
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.plain_cg import PlainCG

WITHIN = 2.0
"""An energy error is estimated: what is called converged may miss the tolerance by this factor."""


def solutions(case: Case, most: int = 300) -> list[Solution]:
    """By cycles of both kinds of coarse matrices and by conjugate gradients."""
    parts = (max(4, case.mesh.n_cells // 4), max(4, case.mesh.n_cells // 16))
    hierarchy = agglomerate(case.mesh, n_parts=parts)
    asked = {"degree": case.degree, "tolerance": case.tolerance}
    solvers = (
        PaperMultigrid(**asked, max_iterations=most),
        PaperMultigrid(**asked, max_iterations=most, operators="inherited"),
        PlainCG(**asked, max_iterations=10 * most),
    )
    return [solver.solve(case.problem, hierarchy) for solver in solvers]


def checked(case: Case, most: int = 300) -> int:
    """How many of the solutions are called converged; fails unless all of them are right."""
    found = [each for each in solutions(case, most) if each.converged]
    for solution in found:
        assert solution.tests == ("residual", "energy error")
        assert solution.energy_error <= case.tolerance
        rest = solution.x if solution.lifting is None else solution.lifting.rest
        assert energy_error(case, rest) <= WITHIN * case.tolerance
    return len(found)


@pytest.mark.parametrize("seed", [1, 4, 6, 11])
def test_what_is_called_converged_is_right(seed: int) -> None:
    assert checked(random_case(seed, largest=7), most=100) >= 1


@pytest.mark.slow
def test_what_is_called_converged_is_right_on_fifty_problems() -> None:
    """Most of the 150 solutions are called converged; the others are on graded meshes mostly."""
    assert sum(checked(random_case(seed)) for seed in range(1000, 1050)) >= 100


@pytest.mark.parametrize("solver", [PaperMultigrid(operators="inherited"), PlainCG()])
def test_a_small_residual_alone_is_not_believed(solver: PaperMultigrid | PlainCG) -> None:
    """On a mesh graded to 1e-2 in both directions it passes long before the error does."""
    mesh = with_four_sides(graded(8, 1e-2, both=True))
    case = Case(mesh, Diffusion(1.0, 1.0, {1: 0.0, 2: 1.0}), 1, solver.tolerance)
    hierarchy = agglomerate(mesh, n_parts=(9, 4))
    found = solver.solve(case.problem, hierarchy)
    iterations = int(np.argmax(found.residuals <= 1e-6 * found.residuals[0]))
    assert 0 < iterations < found.iterations
    early = replace_most(solver, iterations).solve(case.problem, hierarchy)
    assert energy_error(case, early.x) > WITHIN * 1e-6
    assert (early.converged, early.tests) == (False, ("residual",))
    assert "energy error about" in early.reason
    assert found.converged
    assert energy_error(case, found.x) <= found.energy_error <= 1e-6


def replace_most(solver: PaperMultigrid | PlainCG, most: int) -> PaperMultigrid | PlainCG:
    """The solver with another number of iterations."""
    other = copy(solver)
    other.max_iterations = most
    return other


SHIFTS = [300.0, 1e6, -1e8]


@pytest.mark.parametrize("solver", [PaperMultigrid(), PlainCG()], ids=["cycles", "cg"])
def test_a_constant_added_to_the_data_is_added_to_the_solution(solver: PaperMultigrid | PlainCG) -> None:
    """Whatever κ and the kinds of boundary; components of the domain may have offsets of their own."""
    mesh = with_four_sides(samples.squares(6))
    hierarchy = agglomerate(mesh, n_parts=(9, 4))
    one = solver.discretisation.project(mesh, 1.0)
    for kappa in (1.0, np.where(mesh.cell_centroids[:, 0] < 0.4, 1.0, 1e3)):
        plain = solver.solve(Diffusion(kappa, 1.0, {1: 0.0, 2: 0.0}, {3: 1.0}), hierarchy)
        for shift in SHIFTS:
            moved = solver.solve(Diffusion(kappa, 1.0, {1: shift, 2: shift}, {3: 1.0}), hierarchy)
            assert (moved.iterations, moved.converged) == (plain.iterations, True)
            assert np.array_equal(moved.lifting.rest, plain.x)
            assert moved.x == pytest.approx(shift * one + plain.x, rel=1e-15)
            assert np.abs(moved.b - moved.A @ moved.x).max() < 1e-10 * np.abs(moved.b).max()


def test_an_offset_that_varies_is_taken_out_as_far_as_it_is_common() -> None:
    mesh = samples.voronoi(60, seed=4)
    hierarchy = agglomerate(mesh, n_parts=(16, 4))
    solver = PaperMultigrid(tolerance=1e-8)
    data = lambda x: np.sin(5 * x[:, 0]) + x[:, 1]  # noqa: E731
    case = Case(mesh, Diffusion(1.0, 1.0, {0: lambda x: 1e6 + data(x)}), 1, 1e-8)
    moved, plain = (
        solver.solve(case.problem, hierarchy),
        solver.solve(Diffusion(dirichlet={0: data}), hierarchy),
    )
    assert moved.converged
    assert energy_error(case, moved.lifting.rest) < WITHIN * 1e-8
    one = solver.discretisation.project(mesh, 1.0)
    assert moved.x - 1e6 * one == pytest.approx(plain.x, abs=1e-7)


def test_components_of_the_domain_have_offsets_of_their_own() -> None:
    mesh = samples.disconnected(4)
    middle = mesh.points[:, 0].mean()
    data = lambda x: np.where(x[:, 0] < middle, -1e7, 1e8)  # noqa: E731
    hierarchy = agglomerate(mesh, n_parts=(8, 4))
    moved, plain = (PlainCG().solve(Diffusion(dirichlet=each), hierarchy) for each in ({0: data}, {}))
    assert (moved.iterations, moved.converged) == (plain.iterations, True)
    assert np.array_equal(moved.lifting.rest, plain.x)


def test_error_norms_of_any_size() -> None:
    mesh, solver = samples.squares(4), PlainCG()
    hierarchy, size = agglomerate(mesh, n_parts=4), 2.0**-700
    plain, small = (
        Diffusion(source=factor, dirichlet={0: exact}, exact=exact)
        for factor, exact in ((1.0, lambda x: x[:, 0]), (size, lambda x: size * x[:, 0]))
    )
    norms = [solver.discretisation.errors(p, mesh, solver.solve(p, hierarchy).x) for p in (plain, small)]
    assert norms[1] == {name: size * norm for name, norm in norms[0].items()}


@pytest.mark.parametrize("shift", [0.0, 1e4, 1e8])
def test_error_norms_do_not_lose_digits_to_an_offset(shift: float) -> None:
    mesh, solver = samples.squares(6), PlainCG(degree=2, tolerance=1e-10)
    exact = lambda x: np.exp(x[:, 0]) * np.sin(x[:, 1])  # noqa: E731
    hierarchy = agglomerate(mesh, n_parts=4)
    norms = []
    for each in (exact, lambda x: shift + exact(x)):
        problem = Diffusion(source=0.0, dirichlet={0: each}, exact=each)
        norms.append(solver.discretisation.errors(problem, mesh, solver.solve(problem, hierarchy).x))
    for name in ("l2", "dg"):
        assert norms[1][name] == pytest.approx(norms[0][name], rel=0.01)


def test_cycles_that_diverge_name_the_way_out() -> None:
    """On triangles of random shape coarse matrices of their own penalty correct too much."""
    hierarchy = agglomerate(samples.random_triangles(226, seed=2), n_parts=(56, 14))
    lost = PaperMultigrid().solve(Diffusion(), hierarchy)
    assert not lost.converged
    assert lost.reason.startswith("diverged: residual")
    assert lost.reason.endswith("; try operators=inherited, or the solver direct or polydg_cg")
    direct = spsolve(sparse.csc_array(lost.A), lost.b)
    for solver in (PaperMultigrid(operators="inherited"), PlainCG()):
        found = solver.solve(Diffusion(), hierarchy)
        assert found.converged
        assert np.linalg.norm(found.x - direct) < 1e-5 * np.linalg.norm(direct)
