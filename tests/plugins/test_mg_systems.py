"""What a linear system may hold, and data of any size."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command_line import Agglo
from random_diffusion import with_four_sides
from scipy import sparse
from scipy.sparse.linalg import aslinearoperator

from agglo_core import Hierarchy, OptionError, agglomerate, samples, write
from agglo_core.problems import Diffusion, Linear
from agglo_core.solvers.solution_report import report, text
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid
from agglo_polydg_mg.plain_cg import PlainCG

SOLVERS = pytest.mark.parametrize("solver", [PaperMultigrid(), PlainCG()], ids=["cycles", "cg"])
MESH = samples.squares(6)
SYSTEM = Linear.example(MESH)
A, B, N = SYSTEM.A, SYSTEM.b, MESH.n_cells


@cache
def levels() -> Hierarchy:
    """Two coarse levels."""
    return agglomerate(MESH, n_parts=(9, 4))


TAKEN = {
    "whole numbers": (A, np.arange(N)),
    "a list": (A, B.tolist()),
    "a dense matrix": (A.toarray(), B),
    "fractions": (A, np.array([Fraction(k, 3) for k in range(N)])),
    "single precision": (A.astype(np.float32), B.astype(np.float32)),
    "small": (A, 1e-200 * B),
    "smaller than all digits": (A, 1e-310 * B),
    "large": (A, 1e250 * B),
    "a small matrix": (1e-200 * A, 1e-200 * B),
}


@SOLVERS
@pytest.mark.parametrize("name", TAKEN)
def test_systems_that_are_taken(name: str, solver: PaperMultigrid | PlainCG) -> None:
    matrix, b = TAKEN[name]
    solution = solver.solve(Linear(matrix, b, SYSTEM.block_offsets), levels())
    values = np.asarray(b, float)
    exact = np.linalg.solve(sparse.csr_array(matrix).toarray().astype(float), values / abs(values).max())
    assert solution.converged
    assert solution.x / abs(values).max() == pytest.approx(exact, rel=1e-5)
    data = report(MESH, SYSTEM, solution)
    assert 0.0 < data["relative_residual"] <= 1.1e-6
    assert 0.0 < data["energy_error"] <= 1e-6


UNSYMMETRIC = sparse.csr_array(A + sparse.coo_array(([0.3], ([2], [5])), shape=A.shape))
REFUSED: dict[str, tuple[object, object, str]] = {
    "complex b": (A, B + 1j, "b holds complex128; expected real numbers"),
    "complex A": (A * 1j, B, "A holds complex128; expected real numbers"),
    "dense complex A": (A.toarray() * 1j, B, "A holds complex128; expected real numbers"),
    "operator": (aslinearoperator(A), B, "A must be a sparse or dense matrix, given Matrix"),
    "no matrix": (None, B, "A must be a sparse or dense matrix, given NoneType"),
    "two at once": (A, np.stack([B, B], axis=1), r"one right-hand side \(n,\), given shape \(36, 2\)"),
    "a column": (A, B[:, None], r"one right-hand side \(n,\), given shape \(36, 1\)"),
    "sparse b": (
        A,
        sparse.csr_array(B[None]),
        r"given a sparse array of shape \(1, 36\): pass b\.toarray\(\)\.ravel\(\)",
    ),
    "nan in b": (A, np.where(np.arange(N) == 3, np.nan, B), "values that are not finite"),
    "infinite A": (A * np.inf, B, "values that are not finite"),
    "short": (A, B[:-1], r"A has shape \(36, 36\) and b \(35,\), but block_offsets define 36 unknowns"),
    "text": (A, ["x"] * N, "b holds <U1; expected real numbers"),
    "objects": (A, [object()] * N, "b must hold real numbers, given"),
    "not symmetric": (UNSYMMETRIC, B, r"A must be symmetric: the entry \(2, 5\) is 0.3, \(5, 2\) is 0"),
}


@SOLVERS
@pytest.mark.parametrize("name", REFUSED)
def test_systems_that_are_refused_by_name(name: str, solver: PaperMultigrid | PlainCG) -> None:
    matrix, b, message = REFUSED[name]
    with pytest.raises(OptionError, match=message):
        solver.solve(Linear(matrix, b, SYSTEM.block_offsets), levels())


@SOLVERS
def test_matrices_that_are_not_positive_definite_are_flagged(solver: PaperMultigrid | PlainCG) -> None:
    insulated = A - sparse.diags_array(A.sum(axis=1))
    for matrix in (A - 2 * sparse.eye_array(N), -A, insulated):
        solution = solver.solve(Linear(matrix, B, SYSTEM.block_offsets), levels())
        assert not solution.converged
        assert "not positive definite" in solution.reason or "singular" in solution.reason


def test_a_singular_system_that_has_solutions_is_given_one() -> None:
    insulated = sparse.csr_array(A - sparse.diags_array(A.sum(axis=1)))
    b = B - B.mean()
    solution = PlainCG().solve(Linear(insulated, b, SYSTEM.block_offsets), levels())
    assert solution.converged
    assert np.linalg.norm(b - insulated @ solution.x) <= 1e-6 * np.linalg.norm(b)


SIDES = with_four_sides(MESH)


@SOLVERS
@pytest.mark.parametrize("size", [2.0**-1000, 2.0**664])
def test_sources_of_any_size(size: float, solver: PaperMultigrid | PlainCG) -> None:
    for make in (
        lambda s: Diffusion(source=s),
        lambda s: Diffusion(source=lambda x: s * x[:, 0]),
        lambda s: Diffusion(1.0, s, {1: s, 2: 3 * s}, {3: s}),
    ):
        plain, other = (solver.solve(make(each), replace(levels(), fine=SIDES)) for each in (1.0, size))
        assert (other.converged, other.iterations) == (True, plain.iterations)
        assert np.array_equal(other.x, size * plain.x)
        assert np.array_equal(other.b, size * plain.b)
        data = report(SIDES, make(size), other, solver.discretisation)
        assert 0.0 < data["relative_residual"] <= 1.1e-6


@SOLVERS
def test_a_source_too_small_for_its_solution_is_refused(solver: PaperMultigrid | PlainCG) -> None:
    with pytest.raises(
        OptionError, match="outside the range of floating-point numbers: give the data in other"
    ):
        solver.solve(Diffusion(source=1e-315), levels())


@pytest.mark.parametrize("solver", ["polydg_mg_paper", "polydg_cg"])
@pytest.mark.parametrize("shift", [1e4, 1e8])
def test_numbers_of_a_file_are_lifted(agglo: Agglo, solver: str, shift: float) -> None:
    write("m.npz", SIDES)
    found = []
    for low in (0.0, shift):
        held = f"[dirichlet]\n1 = {low}\n2 = {low + 1}\n[neumann]\n3 = 0.5\n"
        Path("p.toml").write_text(f"source = 1.0\n{held}")
        done = agglo("solve", "m.npz", "--problem", "p.toml", "--solver", solver, "--parts", "9", "--json")
        found.append(json.loads(done.out))
    plain, moved = found
    for key in ("iterations", "cg_iterations", "converged", "tests_met"):
        assert moved[key] == plain[key]
    assert plain["tests_met"] == ["residual", "energy error"]
    for key in ("relative_residual", "energy_error"):
        assert moved[key] == pytest.approx(plain[key], rel=1e-3)


def test_the_text_says_which_tests_were_met() -> None:
    problem, solver = Diffusion(), PaperMultigrid()
    data = report(MESH, problem, solver.solve(problem, levels()), solver.discretisation)
    lines = " ".join(text("squares", data).split())
    assert "iterations (tolerance met by residual and energy error), relative residual " in lines
    assert f", energy error {data['energy_error']:.2e} " in lines


def callables() -> list[Callable]:
    """Kinds of boundary data in Python: numbers, values of cells, callables."""
    return [lambda s: s, lambda s: np.full(N, s), lambda s: lambda x: s + 0.0 * x[:, 0]]


@pytest.mark.parametrize("make", callables())
def test_every_form_of_boundary_data_is_lifted(make: Callable) -> None:
    plain, moved = (PlainCG().solve(Diffusion(dirichlet={0: make(s)}), levels()) for s in (0.0, 1e6))
    assert plain.lifting is None
    assert np.array_equal(moved.lifting.rest, plain.x)
