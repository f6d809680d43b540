"""Steps in time: where they start from, and that what they claim is what fresh solves claim."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core import Hierarchy, Mesh, OptionError, samples
from agglo_core.arrays import frozen_float, frozen_index
from agglo_core.multigrid import pcg
from agglo_core.problems import Diffusion, Elasticity, Solution
from agglo_polydg_mg.solver.earlier_solutions import WIDE, best_combination, differences_of, half_products
from agglo_polydg_mg.solver.polydg_multigrid import PolyDGMultigrid

Array = NDArray[np.float64]


def positive_definite(n: int, rng: np.random.Generator) -> Array:
    turn = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return np.asarray(turn * np.geomspace(1, 1e4, n) @ turn.T)


def test_the_best_combination_is_that_of_least_squares_in_the_energy_norm() -> None:
    rng = np.random.default_rng(1)
    A, b, V = positive_definite(30, rng), rng.standard_normal(30), rng.standard_normal((3, 30))
    expected = V.T @ np.linalg.solve(V @ A @ V.T, V @ b)
    np.testing.assert_allclose(best_combination(sparse.csr_array(A), b, list(V)), expected, rtol=1e-9)


def test_best_combination_extrapolates_smooth_changes() -> None:
    """Polynomials in time of degree 3 exactly, from vectors alike in five digits."""
    rng = np.random.default_rng(2)
    A, parts = positive_definite(40, rng), rng.standard_normal((4, 40))
    at = [np.polynomial.polynomial.polyval(0.05 * k, parts) for k in range(5)]
    found = best_combination(sparse.csr_array(A), A @ at[4], at[:4])
    assert np.abs(found - at[4]).max() <= 1e-9 * np.abs(at[4]).max()


def test_vectors_that_are_parallel_or_0_do_no_harm() -> None:
    rng = np.random.default_rng(3)
    A, x = positive_definite(20, rng), rng.standard_normal(20)
    for earlier in ([x, x, 2 * x], [np.zeros(20), x], [x, x * (1 + 1e-15)]):
        np.testing.assert_allclose(
            best_combination(sparse.csr_array(A), A @ (3 * x), earlier), 3 * x, rtol=1e-9
        )
    assert not best_combination(sparse.csr_array(A), x, [np.zeros(20)]).any()


@pytest.mark.parametrize("width", [1, 3, 6, 10])
def test_best_combination_agrees_for_block_matrices(width: int) -> None:
    """Its energies come from a kernel of their own, of 8 vectors at most."""
    rng = np.random.default_rng(4)
    n = 8 * width
    A, x, V = positive_definite(n, rng), rng.standard_normal(n), rng.standard_normal((10, n))
    found = best_combination(sparse.bsr_array(A, blocksize=(width, width)), A @ x, list(V))
    expected = best_combination(sparse.csr_array(A), A @ x, list(V[2:]))
    assert np.abs(found - expected).max() <= 1e-6 * np.abs(expected).max()
    difference = x - found
    assert difference @ A @ difference < x @ A @ x


def test_differences_are_those_of_numpy() -> None:
    vectors = np.random.default_rng(5).standard_normal((5, 700))
    table = np.full((700, WIDE), np.nan)
    differences_of(vectors, table)
    for order in range(5):
        expected = np.diff(vectors, order, axis=0)[-1]
        np.testing.assert_allclose(table[:, order], expected / abs(expected).max(), rtol=1e-12, atol=1e-14)
    assert not table[:, 5:].any()


def test_half_products_are_those_of_numpy() -> None:
    rng = np.random.default_rng(6)
    A, V = positive_definite(12, rng), rng.standard_normal((12, WIDE))
    blocks = sparse.bsr_array(A, blocksize=(3, 3))
    arrays = frozen_index(blocks.indptr), frozen_index(blocks.indices), frozen_float(blocks.data)
    products = np.empty((12, WIDE))
    half_products(*arrays, V, products)
    half = np.tril(np.kron(np.tril(np.ones((4, 4)), -1) + 0.5 * np.eye(4), np.ones((3, 3))) * A, 12)
    np.testing.assert_allclose(products, half @ V, rtol=1e-12, atol=1e-12)


def test_the_returned_correction_is_a_step_towards_the_solution() -> None:
    """Of a good preconditioner of whatever scale; none without an iteration."""
    rng = np.random.default_rng(11)
    turn = np.linalg.qr(rng.standard_normal((60, 60)))[0]
    eigenvalues = np.geomspace(1.0, 1e3, 60)
    A, exact = turn * eigenvalues @ turn.T, rng.standard_normal(60)
    M = turn * (rng.uniform(0.6, 1.0, 60) / eigenvalues) @ turn.T
    for scale in (1e-3, 1.0, 1e3):
        found = pcg(A, A @ exact, scale * M, tolerance=1e-3)
        assert found.correction is not None
        left, better = exact - found.x, exact - found.x - found.correction
        assert better @ A @ better < 0.2 * (left @ A @ left)
    assert pcg(A, np.zeros(60)).correction is None


def bare(mesh: Mesh) -> Hierarchy:
    return Hierarchy(mesh, mesh.graph, [], [], nested=True)


def turning(mesh: Mesh, t: float) -> Diffusion:
    x, y = mesh.cell_centroids.T
    kappa = np.exp(np.sin(2 * np.pi * x + t) * np.sin(2 * np.pi * y))
    return Diffusion(kappa=kappa, source=8.0 + 4.0 * np.sin(np.pi * y + t))


@pytest.mark.parametrize("degree", [1, 2])
def test_twenty_steps_claim_what_holds_and_take_few_iterations(degree: int) -> None:
    """The error in the energy norm, by a direct solver, is what each step says, as that of a fresh solve."""
    mesh = samples.voronoi(250, seed=41 + degree)
    solver, hierarchy = PolyDGMultigrid(degree=degree, tolerance=1e-6), bare(mesh)
    steps, counts = solver.repeated(hierarchy), np.zeros(2)
    for k in range(20):
        problem = turning(mesh, 0.05 * k)
        kept, fresh = steps.solve(problem), solver.solve(problem, hierarchy)
        exact = spsolve(kept.A.tocsc(), kept.b)
        wrong = kept.x - exact
        assert kept.converged
        assert np.sqrt(wrong @ (kept.A @ wrong)) <= 1.5e-6 * np.sqrt(exact @ kept.b)
        assert np.linalg.norm(kept.b - kept.A @ kept.x) <= 1e-6 * np.linalg.norm(kept.b)
        assert len(kept.residuals) == kept.iterations + 1
        counts += kept.iterations, fresh.iterations
    assert steps.setups <= 2
    assert counts[0] <= 0.75 * counts[1]


def test_a_step_far_from_all_before_is_solved_as_well() -> None:
    mesh, rng = samples.voronoi(400, seed=44), np.random.default_rng(4)
    steps = PolyDGMultigrid(tolerance=1e-8).repeated(bare(mesh))
    for kappa in (np.ones(400), 1.01 * np.ones(400), 10.0 ** rng.uniform(-3, 3, 400), np.ones(400)):
        it = steps.solve(Diffusion(kappa=kappa, source=8.0))
        exact = spsolve(it.A.tocsc(), it.b)
        wrong = it.x - exact
        assert it.converged
        assert np.sqrt(wrong @ (it.A @ wrong)) <= 1.5e-8 * np.sqrt(exact @ it.b)


def test_a_step_that_repeats_the_last_one_takes_next_to_nothing() -> None:
    mesh = samples.squares(20)
    steps = PolyDGMultigrid(tolerance=1e-6).repeated(bare(mesh))
    first, again = (steps.solve(Diffusion(source=8.0)) for _ in range(2))
    assert again.iterations <= 2 < first.iterations
    assert again.converged


def front(mesh: Mesh, at: float, ratio: float = 1e4) -> Diffusion:
    return Diffusion(kappa=np.where(mesh.cell_centroids[:, 0] < at, ratio, 1.0), source=1.0)


MOVING = [samples.voronoi(400, seed=45), samples.random_triangles(200, seed=45), samples.tetrahedra(3)]


@pytest.mark.parametrize("ratio", [2.0, 1e2, 1e6])
@pytest.mark.parametrize("mesh", MOVING, ids=["Voronoi", "triangles", "tetrahedra"])
def test_a_moving_front_takes_few_iterations_more_than_fresh_solves(mesh: Mesh, ratio: float) -> None:
    """Levels of an earlier front would take three times as many."""
    solver = PolyDGMultigrid(tolerance=1e-8)
    steps, fresh, kept = solver.repeated(bare(mesh)), [], []
    for k in range(8):
        problem = front(mesh, 0.2 + 0.08 * k, ratio)
        it = steps.solve(problem)
        exact = spsolve(it.A.tocsc(), it.b)
        assert it.converged or it.rounding_limited
        assert np.abs(it.x - exact).max() <= 1e-6 * np.abs(exact).max()
        assert len(it.residuals) == it.iterations + 1
        kept.append(it.iterations)
        fresh.append(solver.solve(problem, bare(mesh)).iterations)
    assert sum(kept) <= 1.3 * sum(fresh)
    assert max(np.subtract(kept, 1.3 * np.array(fresh))) <= 3


def test_levels_are_kept_again_once_a_front_stands() -> None:
    mesh = samples.voronoi(400, seed=46)
    steps = PolyDGMultigrid(tolerance=1e-8).repeated(bare(mesh))
    places = [0.2, 0.5, 0.5, 0.5, 0.5, 0.5]
    counts = []
    for at in places:
        steps.solve(front(mesh, at))
        counts.append(steps.setups)
    assert counts == [1, 2, 2, 2, 2, 2]


def test_the_pace_ends_a_slow_iteration() -> None:
    """Plain conjugate gradients take far more than 30 iterations, with the inverse they take few."""
    A = np.diag(np.geomspace(1.0, 1e4, 50)) + 0.1
    b = np.ones(50)
    slow = pcg(A, b, tolerance=1e-8, pace=30)
    assert (slow.converged, slow.ended) == (False, "most iterations")
    left = np.log(1e8 * np.array(slow.residuals) / slow.residuals[0]) / np.log(1e8)
    late = np.arange(slow.iterations + 1) + 30 * left > 39
    assert late[1:].tolist() == [False] * (slow.iterations - 1) + [True]
    whole = pcg(A, b, tolerance=1e-8)
    assert whole.converged
    assert whole.iterations > 30
    assert np.array_equal(pcg(A, b, tolerance=1e-8, most=slow.iterations).x, slow.x)
    swift = pcg(A, b, np.linalg.inv(1.1 * A), tolerance=1e-8, pace=30)
    assert swift.converged
    with pytest.raises(OptionError, match="pace must be above 0"):
        pcg(A, b, pace=0.0)


def jumping(mesh: Mesh, seed: int) -> Array:
    return np.asarray(10.0 ** np.random.default_rng(seed).uniform(-4, 4, mesh.n_cells))


def sides(mesh: Mesh) -> Mesh:
    """A mesh whose boundary faces on the left have the tag 1, the others 2."""
    middle = mesh.points[mesh.face_pairs].mean(axis=1)
    return replace(mesh, face_tags={"boundary": np.where(middle[:, 0] < 1e-9, 1, 2)})


def wave(points: Array) -> Array:
    return np.asarray(1.5 + np.sin(3.0 * points[:, 0] + points[:, 1]))


def changing(mesh: Mesh) -> list[Diffusion]:
    """Problems of which each changes something else."""
    smooth, rng = 1.0 + mesh.cell_centroids[:, 0], np.random.default_rng(6)
    return [
        Diffusion(kappa=smooth, source=1.0),
        Diffusion(kappa=smooth, source=wave),
        Diffusion(kappa=jumping(mesh, 3), source=wave),
        Diffusion(kappa=2.0, source=rng.standard_normal(mesh.n_cells)),
        Diffusion(kappa=smooth, source=1.0, dirichlet={1: 1.0, 2: wave}),
        Diffusion(kappa=smooth, source=1.0, dirichlet={1: 1.0}, neumann={2: 0.5}),
        Diffusion(kappa=wave, source=1.0, dirichlet={2: 0.0}),
        Diffusion(kappa=smooth, source=1.0, dirichlet={2: 0.0}, neumann={1: wave}),
        Diffusion(kappa=3.0 * smooth, source=0.0, dirichlet={1: 0.0, 2: 2.0}),
    ]


def require_alike(found: Solution, expected: Solution, tolerance: float) -> None:
    assert found.converged
    assert expected.converged
    root = np.sqrt(expected.A.diagonal())
    difference = (found.A - expected.A).tocoo()
    assert (abs(difference.data) <= 1e-12 * root[difference.row] * root[difference.col]).all()
    np.testing.assert_allclose(found.b, expected.b, rtol=1e-10, atol=1e-12 * abs(expected.b).max())
    error = found.x - expected.x
    assert error @ (expected.A @ error) <= (4.0 * tolerance) ** 2 * (expected.x @ (expected.A @ expected.x))


@pytest.mark.parametrize("degree", [1, 2])
def test_steps_solve_the_problem_at_hand_whatever_changed(degree: int) -> None:
    """κ, its jumps and its kind, source, boundary data, and which faces have which."""
    mesh = sides(samples.voronoi(70, seed=7))
    solver = PolyDGMultigrid(degree, tolerance=1e-8)
    steps = solver.repeated(bare(mesh))
    problems = changing(mesh)
    for problem in [*problems, *problems[::-1]]:
        require_alike(steps.solve(problem), solver.solve(problem, bare(mesh)), 1e-8)


def test_a_coefficient_that_is_changed_in_place_is_seen() -> None:
    mesh = samples.squares(8)
    steps, kappa = PolyDGMultigrid().repeated(bare(mesh)), np.ones(mesh.n_cells)
    for factor in (1.0, 2.0, 4.0):
        kappa[: mesh.n_cells // 2] = factor
        found = steps.solve(Diffusion(kappa=kappa, source=1.0))
        require_alike(
            found, PolyDGMultigrid().solve(Diffusion(kappa=kappa.copy(), source=1.0), bare(mesh)), 1e-6
        )


def test_values_of_another_mesh_are_refused_and_do_no_harm() -> None:
    mesh, other = samples.squares(8), samples.squares(9)
    steps = PolyDGMultigrid().repeated(bare(mesh))
    for _ in range(2):
        assert steps.solve(Diffusion(kappa=np.ones(mesh.n_cells), source=1.0)).converged
    with pytest.raises(OptionError, match="kappa has shape"):
        steps.solve(Diffusion(kappa=np.ones(other.n_cells), source=1.0))
    with pytest.raises(OptionError, match="positive"):
        steps.solve(Diffusion(kappa=np.zeros(mesh.n_cells), source=1.0))
    assert steps.solve(Diffusion(kappa=np.ones(mesh.n_cells), source=1.0)).converged


def test_kinds_of_problems_share_no_basis() -> None:
    """Elasticity merges the edges of agglomerates, the penalty of the paper does not."""
    mesh = samples.voronoi(60, seed=2).coarsen(np.arange(60) // 4)
    solver, problem = PolyDGMultigrid(penalty="paper"), Diffusion(source=1.0)
    steps = solver.repeated(bare(mesh))
    assert steps.solve(Elasticity(young=1.0, poisson=0.3, force=(0.0, -1.0))).converged
    assert steps.solve(problem).b.tolist() == solver.solve(problem, bare(mesh)).b.tolist()
    assert abs(steps.solve(problem).A - solver.solve(problem, bare(mesh)).A).max() == 0.0
