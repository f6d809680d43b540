"""One call to solve a problem, or to make levels for a matrix."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import cg, spsolve

import agglo_core as agglo
from agglo_core import Diffusion, FileError, OptionError
from agglo_core.cli import main
from agglo_core.multigrid import pcg
from agglo_core.problems import Solution
from agglo_core.problems.solution import Deferred

MESH = agglo.samples.voronoi(120, seed=1)
PROBLEM = Diffusion(kappa=2.0, source=lambda x: x[:, 0])


def test_a_mesh_and_a_hierarchy_give_the_solution_of_the_built_solver() -> None:
    hierarchy = agglo.agglomerate(MESH, n_parts=(30, 8))
    built = agglo.registry.default().build("solver", "polydg_mg", degree=2, tolerance=1e-10)
    expected = built.solve(PROBLEM, hierarchy)
    found = agglo.solve(hierarchy, PROBLEM, degree=2, tolerance=1e-10)
    assert np.array_equal(found.x, expected.x)
    on_mesh = agglo.solve(MESH, PROBLEM, degree=2, tolerance=1e-10)
    assert on_mesh.converged
    assert on_mesh.x == pytest.approx(expected.x, abs=1e-8 * np.abs(expected.x).max())


def test_solvers_by_name_with_options_and_as_objects_are_the_same() -> None:
    by_name = agglo.solve(MESH, solver="direct", degree=2)
    with_options = agglo.solve(MESH, solver=("direct", {"degree": 2}))
    built = agglo.solve(MESH, solver=agglo.registry.default().build("solver", "direct", degree=2))
    exact = spsolve(sparse.csc_array(by_name.A), by_name.b)
    for solution in (by_name, with_options, built):
        assert solution.x == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((3,), {}, "expects a Mesh or a Hierarchy first, given 3"),
        (([[0, 1]],), {}, "expects a Mesh or a Hierarchy first, given list$"),
        ((agglo.Linear(np.eye(2), np.ones(2)),), {}, r"without a mesh write build_levels\(A\).solve\(b\)"),
        ((MESH,), {"solver": "polydg_mg_paper"}, r"requires levels: give agglo.agglomerate\(mesh"),
        ((MESH,), {"degree": 99}, "degree must be a whole number, 1..6"),
        ((MESH,), {"solver": Diffusion}, "is not a solver: expected a name or an object with solve"),
    ],
)
def test_what_does_not_fit_is_refused(arguments: Any, options: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        agglo.solve(*arguments, **options)


def test_options_beside_an_object_are_refused() -> None:
    solver = agglo.registry.default().build("solver", "direct")
    with pytest.raises(OptionError, match="options apply only to solvers given by name; given degree"):
        agglo.solve(MESH, solver=solver, degree=2)


def test_a_solution_prints_its_outcome_and_its_levels() -> None:
    solution = agglo.solve(MESH, degree=1)
    shown = repr(solution)
    assert shown.startswith(
        f"Solution(360 unknowns, converged after {solution.iterations} iterations, residual "
    )
    assert "\n" not in shown
    rows = repr(solution.levels).splitlines()
    assert rows[0].split() == ["level", "unknowns", "entries"]
    assert [row.split()[1] for row in rows[1:]] == [str(A.shape[0]) for A, _ in solution.operators]


def test_errors_are_norms_against_the_exact_solution_for_every_solver() -> None:
    hierarchy = agglo.agglomerate(MESH, n_parts=(30, 8))
    cubic = Diffusion(source=lambda x: -6.0 * x[:, 0], dirichlet={0: _cube}, exact=_cube)
    for solver in ("polydg_mg", "direct", "polydg_mg_paper", "polydg_cg"):
        errors = agglo.solve(hierarchy, cubic, solver, degree=3, tolerance=1e-10).errors()
        assert set(errors) == {"l2", "dg"}
        assert 0.0 < errors["l2"] < errors["dg"] < 1e-5  # cubic polynomials are in the space
    shifted = Diffusion(source=cubic.source, dirichlet={0: _cube}, exact=lambda x: _cube(x) + 2.0)
    solution = agglo.solve(hierarchy, cubic, degree=3, tolerance=1e-10)
    offset = replace(solution, problem=shifted).errors()
    assert offset["l2"] == pytest.approx(2.0 * np.sqrt(MESH.cell_measures.sum()), rel=1e-6)


def test_boundary_data_without_tags_are_refused_with_what_to_write() -> None:
    for data in (_cube, 2.0, [1.0, 2.0]):
        with pytest.raises(
            OptionError, match=r"given .*: write dirichlet=\{0: data\} on .*face_tags\['wall'\]"
        ):
            Diffusion(dirichlet=data, boundary="wall")  # type: ignore[arg-type]


def _cube(points: Any) -> Any:
    return points[:, 0] ** 3


def test_solve_adds_the_interpretation_that_a_solver_leaves_out() -> None:
    class Bare:
        needs_levels = False
        discretisation = agglo.registry.default().build("discretisation", "polydg", degree=1)

        def solve(self, problem: Any, hierarchy: Any) -> Solution:
            solution = agglo.solve(hierarchy, problem, "direct", degree=1)
            return replace(solution, A=Deferred(_fail), problem=None, discretisation=None, mesh=None)

    solution = agglo.solve(MESH, Diffusion(dirichlet={0: _cube}, exact=_cube), Bare())
    assert solution.discretisation is Bare.discretisation
    assert (solution.mesh, set(solution.errors())) == (MESH, {"l2", "dg"})
    assert isinstance(vars(solution)["A"], Deferred)  # not computed


def _fail() -> None:
    raise AssertionError("computed without need")


def test_errors_and_files_need_an_exact_solution_and_a_discretisation(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"kind diffusion has no exact solution .* Diffusion\(…, exact=u\)"):
        agglo.solve(MESH, degree=1).errors()
    linear = agglo.solve(MESH, agglo.Linear.example(MESH), "direct")
    for attempt in (linear.errors, partial(linear.write, tmp_path / "u.vtu")):
        with pytest.raises(OptionError, match="not for linear systems"):
            attempt()
    with pytest.raises(FileError, match=r"u.npz: a solution can only be written as .vtu"):
        agglo.solve(MESH, degree=1).write(tmp_path / "u.npz")


def test_a_solution_is_written_as_by_the_command_line(tmp_path: Path) -> None:
    source, ours, theirs = (tmp_path / name for name in ("mesh.npz", "ours.vtu", "theirs.vtu"))
    agglo.write(source, MESH)
    solution = agglo.solve(agglo.read(source), Diffusion(source=8.0), "direct", degree=1)
    solution.write(ours)
    arguments = f"{source} --solver direct --degree 1 --no-cg -o {theirs}".split()
    with pytest.raises(SystemExit) as ended:
        main(["solve", *arguments])
    assert ended.value.code == 0
    assert ours.read_bytes() == theirs.read_bytes()


def of_blocks() -> tuple[Any, Any, Any]:
    """A graph Laplacian with a shift, in blocks of two coupled unknowns, and a hierarchy of its cells."""
    mesh = agglo.samples.squares(24)
    hierarchy = agglo.agglomerate(mesh, n_parts=(144, 36))
    A = sparse.csr_array(sparse.kron(agglo.Linear.example(mesh).A, [[2.0, 0.5], [0.5, 1.0]]))
    return A, hierarchy, np.random.default_rng(3).normal(size=A.shape[0])


@pytest.mark.parametrize("on_agglomerates", [False, True])
def test_levels_of_a_matrix_of_blocks_solve_it(on_agglomerates: bool) -> None:
    A, hierarchy, b = of_blocks()
    offsets = np.arange(0, A.shape[0] + 1, 2)
    levels = agglo.build_levels(A, hierarchy if on_agglomerates else None, block_offsets=offsets)
    solution = levels.solve(b, tolerance=1e-10)
    assert isinstance(solution, Solution)
    assert solution.converged
    assert solution.iterations < 25
    assert solution.x == pytest.approx(spsolve(sparse.csc_array(A), b), abs=1e-8)
    assert len(levels.table) == len(solution.operators) >= 2
    assert levels.table.smoothers == ("BlockGaussSeidel",) * (len(levels.table) - 1) + ("direct",)
    assert repr(levels).splitlines()[-1].split()[-1] == "direct"


def test_levels_of_a_hierarchy_take_equal_blocks_without_offsets() -> None:
    A, hierarchy, b = of_blocks()
    given = agglo.build_levels(A, hierarchy, block_offsets=np.arange(0, A.shape[0] + 1, 2)).solve(b)
    assert np.array_equal(agglo.build_levels(A, hierarchy).solve(b).x, given.x)
    with pytest.raises(OptionError, match="block_offsets are required: 1151 unknowns"):
        agglo.build_levels(A[:-1, :-1], hierarchy)


def test_blocks_come_from_their_size_or_from_a_bsr_matrix() -> None:
    A, hierarchy, b = of_blocks()
    offsets = np.arange(0, A.shape[0] + 1, 2)
    rows, blocks = sparse.csr_array(A), sparse.bsr_array(A, blocksize=(2, 2))
    expected = agglo.build_levels(rows, block_offsets=offsets)
    for levels in (
        agglo.build_levels(blocks),
        agglo.build_levels(rows, block_offsets=2),
        agglo.build_levels(blocks, block_offsets=np.int64(2)),
    ):
        assert np.array_equal(levels.system.block_offsets, offsets)
        assert repr(levels) == repr(expected)
        assert levels.solve(b).x == pytest.approx(expected.solve(b).x, rel=1e-6)
    assert agglo.build_levels(blocks, block_offsets=1).system.width == 1
    assert (
        agglo.build_levels(sparse.bsr_array(A, blocksize=(2, 4))).system.width == 1
    )  # no blocks of unknowns
    for problem in (agglo.Linear(blocks, b), agglo.Linear(rows, b, 2)):
        assert np.array_equal(problem.block_offsets, offsets)
        assert agglo.solve(hierarchy, problem).converged
    assert len(agglo.Linear(rows, b).block_offsets) == A.shape[0] + 1
    for size in (0, 5, -2):
        with pytest.raises(OptionError, match=f"{size} is a block size, but 1152 unknowns cannot"):
            agglo.build_levels(rows, block_offsets=size)
    for wrong in (True, 2.0, "2"):
        with pytest.raises(OptionError, match="block_offsets must be a block size or whole numbers"):
            agglo.build_levels(rows, block_offsets=wrong)
        with pytest.raises(OptionError, match="must be a number of unknowns per cell or an array"):
            agglo.Linear(rows, b, wrong)


def test_the_error_for_another_number_of_cells_names_the_block_size() -> None:
    A, hierarchy, b = of_blocks()
    problem = agglo.Linear(sparse.csr_array(A), b)
    for solver in ("polydg_mg", "direct"):
        with pytest.raises(
            OptionError, match=r"in 1152 cells, .* 2 unknowns in every cell give Linear\(A, b, 2\)"
        ):
            agglo.solve(hierarchy, problem, solver)


def test_several_right_hand_sides_have_an_outcome_each() -> None:
    A, _, b = of_blocks()
    sides = np.stack([b, np.zeros(len(b)), 1e-9 * np.arange(len(b))], axis=1)
    levels = agglo.build_levels(A, block_offsets=2)
    solution = levels.solve(sides, tolerance=1e-10)
    assert solution.converged
    assert solution.x == pytest.approx(spsolve(sparse.csc_array(A), sides), rel=1e-7, abs=1e-12)
    assert [column.iterations for column in solution.columns] == [
        levels.solve(side, tolerance=1e-10).iterations for side in sides.T
    ]
    assert solution.iterations == max(column.iterations for column in solution.columns)
    assert repr(solution).startswith("Solution(1152 unknowns, 3 right-hand sides, converged after")
    stopped = levels.solve(sides, max_iterations=2)
    assert [column.converged for column in stopped.columns] == [False, True, False]
    assert (stopped.converged, stopped.reason) == (False, stopped.columns[0].reason)
    again = levels.solve(sides, solution.x)
    assert again.iterations <= 1
    for wrong in (sides[:-1], sides[:, :0], sides[None]):
        with pytest.raises(OptionError, match=r"b must be|A has shape"):
            levels.solve(wrong)


def test_columns_of_a_linear_problem_are_those_of_single_solves() -> None:
    A, hierarchy, b = of_blocks()
    sides = np.stack([b, 1e-200 * b], axis=1)  # scaled by different powers of two
    solution = agglo.solve(hierarchy, agglo.Linear(A, sides, 2), tolerance=1e-10)
    assert np.array_equal(np.stack([column.x for column in solution.columns], axis=1), solution.x)
    assert solution.columns[1].residuals[0] == pytest.approx(1e-200 * solution.columns[0].residuals[0])
    assert agglo.solve(hierarchy, agglo.Linear(A, b, 2)).columns == ()


def test_options_named_as_in_scipy_or_pyamg_get_a_hint() -> None:
    A, hierarchy, b = of_blocks()
    levels = agglo.build_levels(A)
    for name, ours in (("tol", "tolerance"), ("rtol", "tolerance"), ("maxiter", "max_iterations")):
        with pytest.raises(TypeError, match=rf"'{name}' \(did you mean '{ours}'\?\)"):
            levels.solve(b, **{name: 1})
        with pytest.raises(OptionError, match=rf"'{name}' \(did you mean '{ours}'\?\)"):
            agglo.solve(hierarchy, **{name: 1})
    with pytest.raises(TypeError, match=r"'maxiter' \(did you mean 'most'\?\)"):
        pcg(A, b, maxiter=1)  # type: ignore[call-arg]


def test_levels_and_complexities_are_those_of_the_stack() -> None:
    levels = agglo.build_levels(of_blocks()[0])
    rows = repr(levels).splitlines()[1:]
    assert [level.A.shape[0] for level in levels.levels] == [int(row.split()[1]) for row in rows]
    entries = [int(row.split()[2]) for row in rows]
    assert levels.operator_complexity == sum(entries) / entries[0]
    assert levels.grid_complexity == sum(level.A.shape[0] for level in levels.levels) / levels.system.n


@pytest.mark.parametrize("kind", ["V", "W"])
def test_a_cycle_is_a_symmetric_preconditioner(kind: str) -> None:
    A, _, b = of_blocks()
    M = agglo.build_levels(A).aspreconditioner(kind)
    x, failed = cg(A, b, M=M, rtol=1e-10)
    assert not failed
    assert x == pytest.approx(spsolve(sparse.csc_array(A), b), abs=1e-7)
    y = np.cos(np.arange(A.shape[0]))
    assert (M @ b) @ y == pytest.approx(b @ (M @ y), rel=1e-9)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.ones(3), "A must be a sparse or dense matrix"),
        ([[1.0, 2.0], [0.0, 1.0]], "A must be symmetric"),
        ([[-1.0, 0.0], [0.0, 1.0]], "diagonal of the matrix must be positive; row 0 has -1"),
        ([[np.nan, 0.0], [0.0, 1.0]], "not finite"),
    ],
)
def test_matrices_that_are_not_definite_are_refused(matrix: Any, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        agglo.build_levels(matrix if np.ndim(matrix) == 1 else sparse.csr_array(matrix))


@pytest.mark.parametrize(
    ("name", "options", "shown"),
    [
        ("polydg_mg", {"degree": 2, "cycle": "W"}, "PolyDGMultigrid(degree=2, cycle='W')"),
        ("direct", {}, "Direct()"),
        ("polydg_cg", {"tolerance": 1e-9}, "PlainCG(tolerance=1e-09)"),
    ],
)
def test_a_solver_prints_the_options_that_are_not_defaults(name: str, options: Any, shown: str) -> None:
    assert repr(agglo.registry.default().build("solver", name, **options)) == shown


def test_masked_and_complex_numbers_are_refused() -> None:
    A, _, b = of_blocks()
    levels = agglo.build_levels(A)
    hidden = np.ma.masked_array(b, np.arange(len(b)) == 3)
    for given in (hidden, 1j * b, b[:-1], np.where(np.arange(len(b)) == 3, np.nan, b)):
        with pytest.raises(OptionError, match="b "):
            levels.solve(given)
    with pytest.raises(OptionError, match="near_null"):
        agglo.build_levels(A, near_null=hidden[:, None])
    with pytest.raises(OptionError, match="block_offsets"):
        agglo.build_levels(A, block_offsets=np.arange(0, len(b) + 1, 2) + 0.5)
