"""Classical multigrid: what it keeps exactly, kernels beside slow twins, iterations beside those of PyAMG."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from flux_matrices import (
    bilinear_elements,
    five_points,
    iterations,
    linear_elements,
    two_point_flux,
    two_valued,
)
from scipy import sparse
from scipy.sparse.linalg import cg

from agglo_core import agglomerate, samples
from agglo_core.arrays import frozen
from agglo_core.errors import OptionError
from agglo_core.multigrid import CoarseFirst, classical_stack, cycle
from agglo_core.multigrid.kernels.coarse_points import (
    classical_weights,
    coarse_first,
    coarse_points,
    strong_entries,
)
from agglo_core.multigrid.kernels.galerkin_product import galerkin_product
from agglo_core.multigrid.matrices.checks import canonical

pyamg = pytest.importorskip("pyamg")


FRESH = 20261127


def random_matrix(n: int, seed: int) -> sparse.csr_array:
    """Symmetric, diagonally dominant, mostly of negative entries, as wild as 1e±2."""
    rng = np.random.default_rng(seed)
    dense = np.triu(-(10.0 ** rng.uniform(-2, 2, (n, n))) * (rng.random((n, n)) < 5.0 / n), 1)
    dense *= np.where(rng.random((n, n)) < 0.1, -1.0, 1.0)
    dense += dense.T
    return canonical(sparse.csr_array(dense + np.diag(np.abs(dense).sum(axis=1) + 1e-3)))


def best_of_pyamg(A: sparse.csr_array, b: np.ndarray) -> float:
    """Iterations of the better of its two methods, as they are by default; inf if neither converges in 60."""
    matrix, counts = sparse.csr_matrix(A), []
    matrix.indices, matrix.indptr = (each.astype(np.int32) for each in (matrix.indices, matrix.indptr))
    for method in (pyamg.ruge_stuben_solver, pyamg.smoothed_aggregation_solver):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its own loops
            seen: list[int] = []
            M = method(matrix).aspreconditioner()
            failed = cg(A, b, rtol=1e-8, maxiter=60, M=M, callback=lambda _, seen=seen: seen.append(0))[1]
            counts.append(np.inf if failed else len(seen))
    return min(counts)


def matrices(n: int, seed: int) -> dict[str, sparse.csr_array]:
    """The matrices of the claim, on a fresh mesh."""
    squares, voronoi = samples.squares(n), samples.voronoi(n * n, seed)
    found = {
        "anisotropic": five_points(n, 1.0, 1e-3),
        "linear elements": linear_elements(samples.random_triangles(n * n, seed=seed))[0],
    }
    rng = np.random.default_rng(seed)
    for name, mesh in (("squares", squares), ("voronoi", voronoi)):
        board = np.floor(mesh.cell_centroids * 8).astype(int).sum(axis=1) % 2
        kappas = (
            np.ones(n * n),
            np.where(board, 1e6, 1.0),
            10.0 ** rng.uniform(-3, 3, n * n),
            two_valued(n * n, seed),
        )
        for how, kappa in zip(("one", "checks", "wild", "two"), kappas, strict=True):
            found[f"{name} {how}"] = two_point_flux(mesh, kappa)
    return found


def test_never_a_third_more_iterations_than_the_better_method_of_pyamg() -> None:
    """And convergence where that has none. The seed is a new one each time."""
    seed = int(np.random.default_rng().integers(10**6))
    for name, A in matrices(48, seed).items():
        b = np.random.default_rng(seed).standard_normal(A.shape[0])
        stack = classical_stack(A)
        ours = iterations(A, cycle(stack), b)
        assert ours <= 1.3 * best_of_pyamg(A, b), (name, seed)
        assert ours <= 16, (name, seed)
        assert stack.operator_complexity < 3.5, (name, seed)


@pytest.mark.parametrize("ratio", [1e1, 1e3, 1e6])
def test_bilinear_elements_on_stretched_cells(ratio: float) -> None:
    """Cells of equal, random and growing width. Diagonal neighbours as C-points cost 60 to 300 iterations."""
    random = np.random.default_rng(FRESH)
    heights = np.full(60, 1.0 / ratio)
    for widths in (np.ones(60), 10.0 ** random.uniform(-0.5, 0.5, 60), 1.4 ** (np.arange(60) % 10)):
        A = bilinear_elements(widths, heights)
        stack = classical_stack(A)
        assert iterations(A, cycle(stack), random.standard_normal(A.shape[0])) <= 15, f"seed {FRESH}"
        assert stack.operator_complexity <= 2.3


def test_agglomerates_of_a_mesh_as_aggregates() -> None:
    """After one classical step: the bar holds, and the second coarse level has the agglomerates."""
    mesh = samples.random_triangles(4096, seed=16)
    A, vertices = linear_elements(mesh)
    corner = mesh.boundary_loops.vertices.reshape(-1, 3)
    labels = []
    for each in agglomerate(mesh, cells_per_part=(16, 128)).levels:
        first = np.empty(len(mesh.points), np.int64)
        first[corner[::-1].ravel()] = np.repeat(each[::-1], 3)
        labels.append(np.unique(first[vertices], return_inverse=True)[1])
    stack = classical_stack(A, labels=labels)
    b = np.random.default_rng(16).standard_normal(A.shape[0])
    assert iterations(A, cycle(stack), b) <= 1.3 * best_of_pyamg(A, b)
    aggregates = stack.levels[2].A.shape[0]
    assert labels[0].max() + 1 <= aggregates <= 1.2 * (labels[0].max() + 1)


def test_unknowns_that_are_scaled_do_no_harm() -> None:
    """A vector close to the null space is found, or given; ones alone would take a hundred iterations."""
    A = five_points(50, 1.0, 1.0)
    d = 10.0 ** np.random.default_rng(3).uniform(-1, 1, 2500)
    D = sparse.diags_array(d)
    scaled = sparse.csr_array(D @ A @ D)
    b = np.random.default_rng(4).standard_normal(2500)
    found, given = classical_stack(scaled), classical_stack(scaled, near_null=1.0 / d)
    assert iterations(scaled, cycle(found), b) <= 12
    assert iterations(scaled, cycle(given), b) <= 8
    assert np.allclose((given.scaling @ scaled @ given.scaling).toarray(), A.toarray())
    assert classical_stack(A, near_null=np.full(2500, 2.0)).scaling is None


def test_the_cycle_is_symmetric_and_positive_definite() -> None:
    A = two_point_flux(samples.voronoi(300, seed=8), two_valued(300, 1))
    M = cycle(classical_stack(A, coarsest=20)) @ np.eye(300)
    assert np.abs(M - M.T).max() <= 1e-9 * np.abs(M).max()
    assert np.linalg.eigvalsh(0.5 * (M + M.T)).min() > 0.0


def test_levels_of_five_points_are_exact_between_the_first_two() -> None:
    """Red points stay: the others are coupled to them alone, and one sweep over each leaves no error."""
    A = five_points(20, 1.0, 1.0)
    stack = classical_stack(A, coarsest=200)
    assert [level.A.shape[0] for level in stack.levels] == [400, 200]
    b = np.random.default_rng(5).standard_normal(400)
    assert np.abs(A @ (cycle(stack) @ b) - b).max() < 1e-10


def test_constants_and_coarse_matrices_are_exact() -> None:
    A = two_point_flux(samples.voronoi(700, seed=4), two_valued(700, 2), dirichlet=False)
    stack = classical_stack(A, coarsest=30)
    for level, below in zip(stack.levels, stack.levels[1:], strict=False):
        assert np.abs(level.P @ np.ones(level.P.shape[1]) - 1.0).max() < 1e-8
        galerkin = level.P.T @ level.A @ level.P
        assert np.abs((galerkin - below.A).toarray()).max() <= 1e-12 * np.abs(level.A.data).max()
    b = np.random.default_rng(0).standard_normal(700)
    assert iterations(A, cycle(stack), b - b.mean()) <= 17


@pytest.mark.parametrize("seed", [21, 22])
def test_points_that_stay(seed: int) -> None:
    """Each other unknown depends on one that stays, and on a common one with each other it depends on."""
    A = random_matrix(80, seed)
    strong, needy = strong_entries(A.indptr, A.indices, A.data, 0.25, 0.1)
    dense = A.toarray()
    off = -dense + np.diag(np.diag(dense))
    largest = np.maximum(off.max(axis=1, keepdims=True), 1e-300)
    theta = np.where((-off).max(axis=1, keepdims=True) >= 0.25 * largest, 0.5, 0.25)
    expected = (off >= theta * largest) & (
        np.abs(off).sum(axis=1, keepdims=True) > 0.1 * np.diag(dense)[:, None]
    )
    pattern = sparse.csr_array((strong.astype(float), A.indices, A.indptr), shape=A.shape).toarray() > 0.0
    assert (pattern == expected).all()
    stays = coarse_points(A.indptr, A.indices, strong, needy)
    assert 0 < stays.sum() < 80
    for i in np.flatnonzero(~stays):
        assert not needy[i] or (pattern[i] & stays).any()
        for j in np.flatnonzero(pattern[i] & ~stays):
            assert (pattern[i] & pattern[j] & stays).any()
    number = np.cumsum(stays, dtype=np.int32) - np.int32(1)
    graph, to, weight = classical_weights(A.indptr, A.indices, A.data, strong, stays, number)
    P = sparse.csr_array((weight, to, graph), shape=(80, int(stays.sum())))
    assert np.abs(P.toarray() - weights_twin(dense, pattern, stays)).max() < 1e-12
    found = galerkin_product(A.indptr, A.indices, A.data, P.indptr, P.indices, P.data, P.shape[1])
    coarse = sparse.csr_array((found[2], found[1], found[0]), shape=(P.shape[1],) * 2)
    assert coarse.has_canonical_format
    assert np.abs((coarse - P.T @ A @ P).toarray()).max() < 1e-10 * np.abs(A.data).max()


def weights_twin(A: np.ndarray, strong: np.ndarray, stays: np.ndarray) -> np.ndarray:
    """Interpolation in dense algebra, one row after the other."""
    P = np.zeros_like(A)
    negative = np.minimum(A, 0.0)
    for i in range(len(A)):
        from_ = strong[i] & stays
        row, own = np.where(from_, A[i], 0.0), 0.0
        for j in np.flatnonzero((A[i] != 0.0) & ~from_):
            shares = np.where(from_, negative[j], 0.0)
            if strong[i, j] and shares.any():
                row += A[i, j] * shares / shares.sum()
            else:
                own += A[i, j]
        P[i] = -row / max(own, -row.sum(), 1e-300)
    P[stays] = np.eye(len(A))[stays]
    return P[:, stays]


def test_the_order_of_the_sweeps() -> None:
    A = random_matrix(60, 23)
    stays = np.random.default_rng(6).random(60) < 0.4
    order = np.argsort(~stays, kind="stable")
    parts = [frozen(each, each.dtype) for each in (A.indptr, A.indices, A.data, stays)]
    indptr, indices, data = coarse_first(*parts, frozen(np.argsort(order), np.int32))
    permuted = sparse.csr_array((data, indices, indptr), shape=A.shape)
    assert permuted.has_canonical_format
    assert np.array_equal(permuted.toarray(), A.toarray()[order][:, order])
    smoother, b = CoarseFirst(A, stays), np.random.default_rng(7).standard_normal(60)
    x = np.zeros(60)
    for i in order:
        x[i] += (b[i] - A.toarray()[i] @ x) / A.toarray()[i, i]
    before, r = smoother.before(b)
    assert np.abs(before - x).max() < 1e-12
    assert np.abs(r - (b - A @ x)).max() < 1e-10
    first = np.stack([smoother.before(each)[0] for each in np.eye(60)], axis=1)
    after = np.stack([smoother.after(each, np.zeros(60)) for each in np.eye(60)], axis=1)
    assert np.abs(first - after.T).max() < 1e-12


def test_what_needs_no_coarse_level_or_gets_none() -> None:
    """A diagonal; couplings all of the wrong sign; parts without couplings to each other; a hub."""
    D = sparse.csr_array(sparse.diags_array(np.linspace(1.0, 2.0, 3000)))
    assert [level.A.shape[0] for level in classical_stack(D).levels] == [3000, 1]
    assert iterations(D, cycle(classical_stack(D))) <= 2
    wrong = sparse.csr_array(sparse.diags_array([1.0, 2.5, 1.0], offsets=[-1, 0, 1], shape=(3000, 3000)))
    assert iterations(wrong, cycle(classical_stack(wrong, coarsest=10))) <= 2
    apart = sparse.csr_array(
        sparse.block_diag([five_points(30, 1.0, 1.0), 1e4 * five_points(25, 1.0, 1.0), D[:9, :9]])
    )
    assert iterations(apart, cycle(classical_stack(apart, coarsest=60))) <= 8
    spokes = -np.ones(2000)
    hub = sparse.block_array(
        [[sparse.csr_array([[2001.0]]), spokes[None]], [spokes[:, None], sparse.eye_array(2000)]]
    )
    assert iterations(sparse.csr_array(hub), cycle(classical_stack(hub, coarsest=10))) <= 3


def test_a_dense_graph_goes_on_by_aggregation() -> None:
    """Where classical levels fill up: points joined at random to those before them, the first ones most."""
    rng = np.random.default_rng(8)
    new = np.tile(np.arange(1, 3000), 3)
    W = sparse.coo_array(
        (np.ones(len(new)), (new, (new * rng.random(len(new)) ** 1.5).astype(int))), (3000, 3000)
    )
    W = sparse.csr_array(W + W.T)
    A = sparse.csr_array(sparse.diags_array(W.sum(axis=1) + 1e-4) - W)
    stack = classical_stack(A)
    assert stack.levels[1].A.nnz <= 2.5 * A.nnz
    assert iterations(A, cycle(stack), rng.standard_normal(3000)) <= 12


def test_single_precision_inside() -> None:
    A = two_point_flux(samples.voronoi(2000, seed=22), np.ones(2000))
    single = classical_stack(A, dtype=np.float32)
    assert {level.A.dtype for level in single.levels} == {np.dtype(np.float32)}
    assert iterations(A, cycle(single)) <= iterations(A, cycle(classical_stack(A))) + 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": np.eye(3)}, "sparse matrix; given ndarray"),
        ({"labels": [[0, 0]]}, r"labels\[0\] has shape \(2,\)"),
        ({"theta": 0.0}, "theta must be between 0 and 1; given 0.0"),
        ({"near_null": [1.0, 0.0, 1.0]}, "one near-null vector with positive entries"),
        ({"near_null": np.ones((3, 2))}, "one near-null vector with positive entries"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        classical_stack(**({"A": sparse.eye_array(3)} | change))


def test_a_guide_chooses_in_place_of_the_matrix() -> None:
    """Levels interpolate as those of the guide do; their matrices are products of the matrix itself."""
    A, guide = five_points(25, 1.0, 0.01), five_points(25, 1.0, 1.0)
    stack, alone = classical_stack(A, guide=guide, coarsest=200), classical_stack(guide, coarsest=200)
    first, second = stack.levels[:2]
    assert np.array_equal(first.P.toarray(), alone.levels[0].P.toarray())
    assert not np.array_equal(first.P.toarray(), classical_stack(A, coarsest=200).levels[0].P.toarray())
    wanted = (first.P.T @ first.A @ first.P).toarray()
    assert np.allclose(second.A.toarray(), wanted, rtol=1e-12, atol=1e-12 * np.abs(wanted).max())
    with pytest.raises(OptionError, match=r"guide has shape \(600, 600\); expected that of A, \(625, 625\)"):
        classical_stack(A, guide=guide[:600, :600])
