"""Smoothed aggregation: what it keeps exactly, and how few iterations it takes on wild matrices."""

from __future__ import annotations

from collections.abc import Callable

import networkx as nx
import numpy as np
import pytest
from flux_matrices import iterations, truss, two_point_flux, two_valued
from scipy import sparse
from scipy.sparse.linalg import spsolve

from agglo_core import agglomerate, samples
from agglo_core.errors import OptionError
from agglo_core.multigrid import LevelStack, aggregation_stack, classical_stack, cycle, pcg


def checkerboard(centroids: np.ndarray) -> np.ndarray:
    return np.where(np.floor(centroids * 8).astype(int).sum(axis=1) % 2, 1e6, 1.0)


@pytest.mark.parametrize("seed", [11, 12])
def test_few_iterations_whatever_the_coefficient(seed: int) -> None:
    """A fresh mesh for each seed; bounds leave two or three iterations to chance."""
    for mesh, bounds in (
        (samples.squares(64), (12, 14, 21, 20)),
        (samples.voronoi(4096, seed), (17, 20, 26, 26)),
    ):
        n = mesh.n_cells
        wild = 10.0 ** np.random.default_rng(seed).uniform(-3, 3, n)
        kappas = (np.ones(n), checkerboard(mesh.cell_centroids), wild, two_valued(n, seed))
        for kappa, bound in zip(kappas, bounds, strict=True):
            A = two_point_flux(mesh, kappa)
            stack = aggregation_stack(A)
            assert iterations(A, cycle(stack), mesh.cell_measures) <= bound
            assert stack.operator_complexity < 2.3


@pytest.mark.parametrize("seed", [1, 2])
def test_labels_where_the_coefficient_jumps_from_cell_to_cell(seed: int) -> None:
    """Aggregates of different size have different near-null values, by which couplings are scaled."""
    mesh = samples.voronoi(4096, seed)
    A = two_point_flux(mesh, two_valued(4096, seed))
    labels = agglomerate(mesh, cells_per_part=(8, 64)).levels
    assert iterations(A, cycle(classical_stack(A, labels=labels, coarsest=100)), mesh.cell_measures) <= 24


@pytest.mark.parametrize("seed", [1, 2])
def test_aggregates_do_not_depend_on_the_scaling_of_unknowns(seed: int) -> None:
    mesh = samples.voronoi(1000, seed)
    A = two_point_flux(mesh, two_valued(1000, seed))
    scale = 2.0 ** np.random.default_rng(seed).integers(-4, 5, 1000)
    D = sparse.diags_array(scale)
    plain, scaled = aggregation_stack(A), aggregation_stack(D @ A @ D, near_null=1 / scale)
    assert np.array_equal(plain.levels[1].labels, scaled.levels[1].labels)


def test_counts_do_not_grow_with_the_mesh() -> None:
    counts = []
    for n in (32, 128):
        mesh = samples.squares(n)
        A = two_point_flux(mesh, np.ones(n * n))
        counts.append(iterations(A, cycle(aggregation_stack(A, coarsest=50))))
    assert counts[1] <= counts[0] + 2


def test_the_cycle_is_symmetric_and_positive_definite() -> None:
    mesh = samples.voronoi(300, seed=8)
    A = two_point_flux(mesh, two_valued(300, 1))
    M = cycle(aggregation_stack(A, coarsest=20)) @ np.eye(300)
    assert np.abs(M - M.T).max() <= 1e-9 * np.abs(M).max()
    assert np.linalg.eigvalsh(0.5 * (M + M.T)).min() > 0.0


def test_galerkin_and_constants_are_exact() -> None:
    """A takes constants to zero: P takes constants to constants, although weak couplings are left out."""
    mesh = samples.voronoi(700, seed=4)
    A = two_point_flux(mesh, two_valued(700, 2), dirichlet=False)
    stack = aggregation_stack(A, coarsest=30)
    ones = np.ones(700)
    for level, below in zip(stack.levels, stack.levels[1:], strict=False):
        coarse = np.linalg.lstsq(level.P.toarray(), ones, rcond=None)[0]
        assert np.abs(level.P @ coarse - ones).max() < 1e-8
        ones = coarse
        galerkin = level.P.T @ level.A @ level.P
        assert np.abs((galerkin - below.A).toarray()).max() <= 1e-12 * np.abs(level.A.data).max()


def test_a_pure_neumann_problem() -> None:
    mesh = samples.voronoi(3000, seed=9)
    A = two_point_flux(mesh, np.ones(3000), dirichlet=False)
    b = np.random.default_rng(0).standard_normal(3000)
    assert iterations(A, cycle(aggregation_stack(A)), b - b.mean()) <= 17


@pytest.mark.parametrize("seed", [3, 4])
def test_rigid_motions_of_a_truss(seed: int) -> None:
    """Two unknowns to a point, three vectors: exact on every level, and worth having."""
    A, motions = truss(1500, seed)
    assert np.abs(A @ motions).max() < 1e-8 * np.abs(A.data).max()
    offsets = np.arange(0, 3001, 2)
    stack = aggregation_stack(A, near_null=motions, block_offsets=offsets, coarsest=100)
    top = stack.levels[0]
    coarse = np.linalg.solve((top.P.T @ top.P).toarray(), top.P.T @ motions)
    assert np.abs(top.P @ coarse - motions).max() < 1e-9
    assert set(np.diff(stack.levels[1].block_offsets)) <= {1, 2, 3}
    held = sparse.csr_array(A + sparse.diags_array(1e-3 * A.diagonal() * (np.arange(3000) < 40)))
    b = np.random.default_rng(1).standard_normal(3000)
    used = {
        name: iterations(
            held, cycle(aggregation_stack(held, near_null=B, block_offsets=offsets, coarsest=100)), b
        )
        for name, B in (("motions", motions), ("shifts", motions[:, :2]))
    }
    assert used["motions"] < used["shifts"]
    assert used["motions"] <= 60


def test_parts_of_different_sizes() -> None:
    """Unknowns of the five-point matrix, in parts of one to three: as good as single ones."""
    mesh = samples.squares(45)
    A = two_point_flux(mesh, np.ones(2025))
    sizes = np.random.default_rng(3).integers(1, 4, 2025)
    offsets = np.append(0, np.cumsum(sizes))
    offsets = np.append(offsets[offsets < 2025], 2025)
    stack = aggregation_stack(A, block_offsets=offsets, near_null=np.ones(2025), coarsest=60)
    assert iterations(A, cycle(stack)) <= 20
    assert stack.levels[1].A.shape[0] == len(stack.levels[1].block_offsets) - 1


def test_levels_from_labels() -> None:
    mesh = samples.squares(24)
    at = np.floor(mesh.cell_centroids * 24).astype(int)
    labels = [at[:, 0] // side * (24 // side) + at[:, 1] // side for side in (3, 6)]
    A = two_point_flux(mesh, np.ones(576))
    stack = aggregation_stack(A, labels=labels, coarsest=20)
    assert [level.A.shape[0] for level in stack.levels] == [576, 64, 16]
    for level, given in zip(stack.levels[1:], labels, strict=True):
        assert len(set(zip(level.labels, given, strict=True))) == level.A.shape[0]
    assert iterations(A, cycle(stack)) <= 14


def test_labels_are_split_where_the_coefficient_jumps() -> None:
    mesh = samples.voronoi(2000, seed=21)
    x, y = mesh.cell_centroids.T
    kappa = np.where(x > 0.45 + 0.3 * y * np.sin(9.0 * y), 1e6, 1.0)
    A = two_point_flux(mesh, kappa)
    cells = np.floor(mesh.cell_centroids * 15).astype(int)
    labels = np.unique(cells[:, 0] * 15 + cells[:, 1], return_inverse=True)[1]
    stack = aggregation_stack(A, labels=[labels])
    mine = stack.levels[1].labels
    assert mine is not None
    assert len(set(zip(mine, labels, strict=True))) == mine.max() + 1 > labels.max() + 10
    crossed = len(set(zip(labels, kappa, strict=True))) - labels.max() - 1
    mixed = len(set(zip(mine, kappa, strict=True))) - mine.max() - 1
    assert mixed <= 0.3 * crossed  # soft cells that lean on stiff ones, having no others in their label
    assert iterations(A, cycle(stack)) <= 22


def test_labels_that_do_not_suit_the_matrix_are_left() -> None:
    mesh = samples.squares(40)
    A, labels = (
        two_point_flux(mesh, two_valued(1600, 5)),
        np.arange(1600) // 40 // 4 * 20 + np.arange(1600) % 40 // 2,
    )
    from_labels, from_graph = aggregation_stack(A, labels=[labels]), aggregation_stack(A)
    assert np.array_equal(from_labels.levels[1].labels, from_graph.levels[1].labels)
    assert (aggregation_stack(A, labels=[labels], theta=0.0).levels[1].labels == labels).all()


def preferential_attachment(n: int, links: int, seed: int) -> sparse.csr_array:
    """Laplacian, plus 0.001, of a graph whose node degrees follow a power law (Barabási, Albert 1999)."""
    graph = nx.to_scipy_sparse_array(nx.barabasi_albert_graph(n, links, seed=seed), dtype=float)
    return sparse.csr_array(sparse.diags_array(graph.sum(axis=1) + 1e-3) - graph)


def joined_to_all(n: int) -> sparse.csr_array:
    """Laplacian, plus 0.001, of a square grid with one more node that is weakly joined to all others."""
    line, one = sparse.diags_array([1.0, 1.0], offsets=[-1, 1], shape=(n, n)), sparse.eye_array(n)
    grid, spokes = sparse.kron(line, one) + sparse.kron(one, line), np.full((n * n, 1), 0.01)
    graph = sparse.csr_array(sparse.block_array([[grid, spokes], [spokes.T, None]]))
    return sparse.csr_array(sparse.diags_array(graph.sum(axis=1) + 1e-3) - graph)


@pytest.mark.parametrize("make_stack", [aggregation_stack, classical_stack])
@pytest.mark.parametrize(
    "A", [preferential_attachment(1_500, 3, 5), preferential_attachment(800, 8, 6), joined_to_all(60)]
)
def test_levels_of_graphs_with_hubs_stay_sparse(
    make_stack: Callable[..., LevelStack], A: sparse.csr_array
) -> None:
    """Smoothed prolongation would make coarse matrices nearly dense, with up to fifty times the entries."""
    stack = make_stack(A, coarsest=100)
    assert max(level.A.nnz for level in stack.levels) <= 2.6 * A.nnz
    assert stack.operator_complexity < 5.0
    b = np.random.default_rng(0).standard_normal(A.shape[0])
    solved = pcg(A, b, cycle(stack), tolerance=1e-8)
    assert (solved.converged, solved.iterations <= 20) == (True, True)
    np.testing.assert_allclose(solved.x, spsolve(sparse.csc_array(A), b), rtol=1e-5, atol=1e-6)


def test_single_precision_inside() -> None:
    mesh = samples.voronoi(2000, seed=22)
    A = two_point_flux(mesh, np.ones(2000))
    single = aggregation_stack(A, dtype=np.float32)
    assert {level.A.dtype for level in single.levels} == {np.dtype(np.float32)}
    assert iterations(A, cycle(single)) <= iterations(A, cycle(aggregation_stack(A))) + 1


def test_what_does_not_coarsen_is_solved_directly() -> None:
    """Couplings all of the wrong sign; and a diagonal, that needs no coarse level."""
    A = sparse.csr_array(sparse.diags_array([1.0, 2.5, 1.0], offsets=[-1, 0, 1], shape=(3000, 3000)))
    stack = aggregation_stack(A, coarsest=10)
    assert len(stack.levels) == 1
    assert iterations(A, cycle(stack)) <= 2
    D = sparse.csr_array(sparse.diags_array(np.linspace(1.0, 2.0, 3000)))
    stack = aggregation_stack(D)
    assert [level.A.shape[0] for level in stack.levels] == [3000, 1]
    assert iterations(D, cycle(stack)) <= 2


def test_the_given_matrix_stays_as_it_is() -> None:
    A = sparse.csr_array((np.array([-1.0, 2.0, 2.0, -1.0]), np.array([1, 0, 1, 0]), np.array([0, 2, 4])))
    before = A.indices.copy()
    aggregation_stack(A, coarsest=1)
    assert np.array_equal(A.indices, before)
    assert A.data.flags.writeable


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": np.eye(3)}, "sparse matrix; given ndarray"),
        ({"A": sparse.eye_array(3, dtype=complex)}, "of complex128"),
        ({"A": sparse.csr_array(np.diag([1.0, np.nan, 1.0]))}, "not finite"),
        ({"A": sparse.csr_array(np.diag([1.0, -2.0, 1.0]))}, "row 1 has -2"),
        ({"block_offsets": [0, 2]}, "increase from 0 to 3"),
        ({"near_null": np.ones(4)}, r"shape \(3, k\); given shape \(4,\)"),
        ({"labels": [[0, 0, 0], [0, 0]]}, r"labels\[1\] has shape \(2,\)"),
        ({"theta": -1.0}, "theta must be 0 or more; given -1.0"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        aggregation_stack(**({"A": sparse.eye_array(3)} | change))
