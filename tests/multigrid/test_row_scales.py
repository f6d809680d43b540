"""Systems whose rows differ by orders of magnitude: measures, penalties, singular matrices, scaling."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from flux_matrices import two_point_flux
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, spsolve

from agglo_core import Hierarchy, Mesh, OptionError, agglomerate, samples
from agglo_core.multigrid import classical_stack, cycle, pcg, pcg_columns
from agglo_core.multigrid.krylov.look_ahead import conjugate_gradients
from agglo_core.problems import Linear, System
from agglo_core.problems.residuals.row_scales import lifted, penalised_rows, row_measure, row_sizes
from agglo_core.registry import default

MESH = samples.squares(16)
N = MESH.n_cells
POISSON = two_point_flux(MESH, np.ones(N))
SOLVERS = {"polydg_mg": {}, "polydg_cg": {}, "multigrid": {}, "direct": {"backend": "superlu"}}


def levels_of(mesh: Mesh) -> Hierarchy:
    return agglomerate(mesh, cells_per_part=(8, 64))


def eliminated(A: sparse.csr_array, b: np.ndarray) -> np.ndarray:
    """The solution by a sparse direct solver, of the matrix scaled to a unit diagonal."""
    d = 1.0 / np.sqrt(A.diagonal())
    scaled = sparse.csc_array(sparse.diags_array(d) @ A @ sparse.diags_array(d))
    x = spsolve(scaled, d * b)
    return np.asarray(d * (x + spsolve(scaled, d * b - scaled @ x)))


def penalised(mesh: Mesh, large: float) -> tuple[sparse.csr_array, np.ndarray]:
    """Values 1 to 2 that a large number imposes on some cells of a mesh, and 0 on one of them."""
    rows = np.arange(0, mesh.n_cells, 7)
    A = sparse.lil_array(two_point_flux(mesh, np.ones(mesh.n_cells)))
    b = 0.01 * mesh.cell_measures
    A[rows, rows] = large
    b[rows] = large * np.linspace(1.0, 2.0, len(rows))
    b[rows[3]] = 0.0
    return sparse.csr_array(A), b


def floating(bodies: int) -> tuple[sparse.csr_array, np.ndarray]:
    """Bodies without Dirichlet values, and loads that balance on each."""
    links = samples.squares(12).graph.to_scipy()
    body = sparse.diags_array(links.sum(axis=1)) - links
    load = np.random.default_rng(bodies).standard_normal((bodies, 144))
    load -= load.mean(axis=1, keepdims=True)
    return sparse.csr_array(sparse.block_diag([body] * bodies)), load.ravel()


def test_sizes_of_rows() -> None:
    A = sparse.csr_array([[4.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, -3.0]])
    assert row_sizes(A).tolist() == [4.0, 1.0, 3.0]
    assert row_sizes(sparse.csr_array(POISSON)).tolist() == POISSON.diagonal().tolist()


def test_the_measure_sees_rows_of_every_size() -> None:
    """Three fields in units of 1, 1e-3 and 1e-6: half of the load of one of them is left."""
    units = np.repeat([1.0, 1e-3, 1e-6], 4)
    measure = row_measure(np.diag(units**2), units)
    for part in range(3):
        assert 0.2 < measure(0.5 * units * (np.repeat(np.arange(3), 4) == part)) < 0.5
    alike = np.arange(1.0, 5.0)
    assert row_measure(np.diag(alike), alike)(alike / 4) == pytest.approx(0.25)
    assert row_measure(LinearOperator((4, 4), matvec=np.copy, dtype=float), alike)(alike) == 1.0


def test_rows_of_penalties_and_what_is_left_without_them() -> None:
    A, b = penalised(MESH, 1e30)
    rows = penalised_rows(A)
    assert rows.tolist() == list(range(0, N, 7))
    for matrix in (A, A.toarray(), sparse.bsr_array(A, blocksize=(2, 2))):
        offset, load = lifted(matrix, np.stack([b, 2.0 * b], axis=1))
        values = np.linspace(1.0, 2.0, len(rows))
        values[3] = 0.0
        assert np.allclose(offset[rows, 0], values, rtol=1e-15)
        assert np.count_nonzero(offset[:, 0]) == len(rows) - 1
        others = A.toarray()
        np.fill_diagonal(others, 0.0)
        inner = np.setdiff1d(np.arange(N), rows)
        assert np.allclose(load[inner, 1], 2.0 * (b - others @ offset[:, 0])[inner])
        assert np.allclose(load[rows, 0], -(others @ offset[:, 0])[rows])
    for plain in (POISSON, sparse.csr_array(POISSON + 1e6 * sparse.eye_array(N))):
        assert not len(penalised_rows(plain))  # large as they may be, no row is larger than others
        assert lifted(plain, b)[1] is b


@pytest.mark.parametrize("large", [1e4, 1e12, 1e100])
@pytest.mark.parametrize("mesh", [MESH, samples.tetrahedra(3)], ids=["squares", "tetrahedra"])
def test_values_imposed_by_penalties_leave_the_others_right(mesh: Mesh, large: float) -> None:
    A, b = penalised(mesh, large)
    exact = eliminated(A, b)
    M = cycle(classical_stack(A))
    problem = Linear(A, b, np.arange(mesh.n_cells + 1))
    hierarchy = levels_of(mesh)
    solved = [
        default().build("solver", name, tolerance=1e-8, **more).solve(problem, hierarchy)
        for name, more in SOLVERS.items()
    ]
    columns = pcg_columns(A, np.stack([b, -3.0 * b], axis=1), M, tolerance=1e-8)
    again = pcg(A, b, M, columns[0].x, tolerance=1e-8)
    found = [*solved, pcg(A, b, M, tolerance=1e-8), conjugate_gradients(A, b, 1e-8), columns[0], again]
    assert again.iterations <= 1
    for it in found:
        assert it.converged
        assert np.abs(it.x - exact).max() <= 1e-6 * np.abs(exact).max()
    assert np.abs(columns[1].x + 3.0 * exact).max() <= 1e-6 * np.abs(exact).max()


def test_several_columns_with_penalties_in_the_default_solver() -> None:
    A, b = penalised(MESH, 1e20)
    B = np.stack([b, MESH.cell_measures, np.zeros(N)], axis=1)
    solver = default().build("solver", "polydg_mg", tolerance=1e-8)
    it = solver.solve(Linear(A, B, np.arange(N + 1)), levels_of(MESH))
    assert it.converged
    for x, column in zip(it.x.T, B.T, strict=True):
        assert np.abs(x - eliminated(A, column)).max() <= 1e-6


@pytest.mark.parametrize("name", ["polydg_mg", "multigrid", "direct"])
def test_what_is_called_converged_is_right_in_every_unit(name: str) -> None:
    solver = default().build("solver", name, tolerance=1e-8, **SOLVERS[name])
    random = np.random.default_rng(5)
    for units in (10.0 ** (6.0 * (np.arange(N) % 3) - 6.0), 10.0 ** (-5.0 * MESH.cell_centroids[:, 0])):
        scale = sparse.diags_array(units)
        A, b = sparse.csr_array(scale @ POISSON @ scale), units * random.standard_normal(N)
        it, exact = solver.solve(Linear(A, b, np.arange(N + 1)), levels_of(MESH)), eliminated(A, b)
        assert it.converged
        for part in (units < 1e-3, (units >= 1e-3) & (units < 10.0), units >= 10.0):
            size = np.linalg.norm(exact[part])
            assert np.linalg.norm((it.x - exact)[part]) <= 1e-6 * size


def test_small_cells_of_a_mass_matrix_are_right() -> None:
    """Cells of a solid whose sizes span ten orders: the smallest are in no norm of the others."""
    mesh = samples.tetrahedra(3)
    mass = 10.0 ** (-10.0 * mesh.cell_centroids[:, 0])
    root = sparse.diags_array(np.sqrt(mass))
    links = sparse.csr_array(mesh.graph.to_scipy() > 0.0).astype(float)
    A = sparse.csr_array(root @ (sparse.eye_array(mesh.n_cells) + 0.2 * links) @ root)
    b = A @ np.linspace(1.0, 2.0, mesh.n_cells)
    for name in ("polydg_mg", "multigrid"):
        solver = default().build("solver", name, tolerance=1e-8)
        it = solver.solve(Linear(A, b, np.arange(mesh.n_cells + 1)), levels_of(mesh))
        assert it.converged
        assert np.abs(it.x - np.linspace(1.0, 2.0, mesh.n_cells)).max() <= 1e-5


@pytest.mark.parametrize("bodies", [1, 2, 5])
def test_floating_bodies_with_balanced_loads(bodies: int) -> None:
    A, b = floating(bodies)
    found = pcg(A, b, cycle(classical_stack(A)), tolerance=1e-8)
    exact = b.reshape(bodies, -1) @ np.linalg.pinv(A[:144, :144].toarray())  # all bodies are equal
    x = found.x.reshape(bodies, -1)
    assert found.converged
    assert np.abs(x - x.mean(axis=1, keepdims=True) - exact).max() <= 1e-6 * np.abs(exact).max()


@pytest.mark.parametrize("bodies", [1, 2])
def test_a_load_out_of_the_range_of_a_singular_matrix_is_named(bodies: int) -> None:
    A, b = floating(bodies)
    problem = Linear(A, b + 1.0, np.arange(len(b) + 1))
    mesh = samples.squares(12)
    graph = samples.voronoi(len(b), seed=1)
    assert graph.n_cells == len(b) == bodies * mesh.n_cells
    for name, more in SOLVERS.items():
        it = default().build("solver", name, tolerance=1e-8, **more).solve(problem, levels_of(graph))
        assert not it.converged
        assert "singular" in it.reason
        assert np.linalg.norm(problem.b - A @ it.x) <= np.linalg.norm(problem.b)
        assert it.residuals[-1] == pytest.approx(np.linalg.norm(problem.b - A @ it.x), rel=1e-6)
    found = pcg(A, b + 1.0, cycle(classical_stack(A)), tolerance=1e-8)
    assert found.ended == "singular matrix"
    assert not found.preconditioner_failed
    least = np.linalg.norm(np.ones(len(b))) / np.linalg.norm(b + 1.0)  # what no x takes out of the load
    assert least <= found.relative_residual <= 1.0


def test_a_nearly_singular_matrix_is_solved() -> None:
    """Its smallest eigenvalue is 1e-9 of the largest, which is no null vector."""
    A, b = floating(2)
    A = sparse.csr_array(A + 1e-8 * sparse.eye_array(len(b)))
    found = pcg(A, b + 1.0, cycle(classical_stack(A)), tolerance=1e-8)
    exact = eliminated(A, b + 1.0)
    assert found.converged
    assert np.abs(found.x - exact).max() <= 1e-6 * np.abs(exact).max()


@pytest.mark.parametrize("name", SOLVERS)
def test_solvers_do_not_depend_on_the_scale_of_the_matrix(name: str) -> None:
    couplings = sparse.csr_array(np.eye(2) + 0.3)
    A, b = sparse.csr_array(sparse.kron(POISSON, couplings)), np.sin(np.arange(2.0 * N))
    at, hierarchy = np.arange(0, 2 * N + 1, 2), levels_of(MESH)
    solver = default().build("solver", name, tolerance=1e-8, **SOLVERS[name])
    once = solver.solve(Linear(A, b, at), hierarchy)
    exact = spsolve(sparse.csc_array(A), b)
    M = solver.aspreconditioner(Linear(A, b, at), hierarchy) @ b
    for matrix, data in ((1e200, 1.0), (1e200, 1e200), (1e-200, 1.0), (1e-40, 1e40), (1e290, 1.0)):
        problem = Linear(matrix * A, data * b, at)
        it = solver.solve(problem, hierarchy)
        assert (it.converged, it.iterations) == (True, once.iterations)
        assert np.abs(it.x / data * matrix - exact).max() <= 1e-6 * np.abs(exact).max()
        assert np.allclose(it.residuals / data, once.residuals, rtol=1e-3, atol=1e-10 * once.residuals[0])
        assert np.array_equal(it.A.toarray(), problem.A.toarray())
        if name != "polydg_cg":  # whose preconditioner is the identity
            found = solver.aspreconditioner(problem, hierarchy) @ b
            assert np.allclose(found * matrix, M, rtol=1e-8, atol=1e-10 * np.abs(M).max())


def test_asymmetry_is_judged_by_the_rows_of_an_entry() -> None:
    """Beside a penalty of 1e20, and in rows of 1e-20."""
    for large, entry, wrong in ((1e20, -1.0, 1e-6), (1e-20, -1e-21, 1e-24)):
        A = np.diag([large, 2.0, 2.0, 3e-20, 3e-20])
        A[1, 2] = A[2, 1] = -1.0
        A[3, 4] = A[4, 3] = -1e-21
        i, j = (1, 2) if entry == -1.0 else (3, 4)
        assert System(A, np.ones(5)).n == 5
        A[i, j] += wrong
        for solve in (lambda A=A: System(A, np.ones(5)), lambda A=A: solved_by_cg(A)):
            with pytest.raises(
                OptionError, match=rf"A must be symmetric: the entry \({i}, {j}\)|\({j}, {i}\)"
            ):
                solve()


def solved_by_cg(A: np.ndarray) -> None:
    graph = samples.squares(5).graph
    hierarchy = Hierarchy(None, graph, [], [], nested=True)
    big = np.eye(25)
    big[:5, :5] = A
    default().build("solver", "polydg_cg").solve(Linear(big, np.ones(25), np.arange(26)), hierarchy)


@pytest.mark.parametrize("change", [1e-2, 1e-6, 1e-9])
def test_the_message_shows_two_different_entries(change: float) -> None:
    A = sparse.diags_array([-1.0, 2.0, -1.0 + change], offsets=[-1, 0, 1], shape=(9, 9))
    with pytest.raises(OptionError, match="A must be symmetric") as refused:
        System(A, np.ones(9))
    text = str(refused.value).split(";")[0]
    entries = [float(each.split(",")[0]) for each in text.split(" is ")[1:]]
    assert sorted(entries) == [-1.0, pytest.approx(-1.0 + change, abs=1e-15 if change < 1e-2 else 1e-6)]
    assert all(one != other for one, other in pairwise(entries))
