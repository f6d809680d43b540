"""Kernels of aggregation and of Gauss–Seidel beside slow, obvious twins."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import solve_triangular
from scipy.sparse.csgraph import connected_components

from agglo_core.arrays import frozen, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid import ScalarGaussSeidel
from agglo_core.multigrid.coarsening.prolongation import Couplings
from agglo_core.multigrid.kernels.aggregates import greedy_aggregates, local_bases, split_labels, split_weak
from agglo_core.multigrid.matrices.checks import canonical


def random_matrix(n: int, seed: int) -> sparse.csr_array:
    """Symmetric, of mixed signs, of wildly different entries and positive diagonal."""
    rng = np.random.default_rng(seed)
    dense = -(10.0 ** rng.uniform(-3, 3, (n, n))) * (rng.random((n, n)) < 4.0 / n)
    dense *= np.where(rng.random((n, n)) < 0.1, -1.0, 1.0)
    dense = np.triu(dense, 1)
    dense = dense + dense.T
    return canonical(sparse.csr_array(dense + np.diag(np.abs(dense).sum(axis=1) + 1e-3)))


def scalar_couplings(A: sparse.csr_array) -> Couplings:
    n = A.shape[0]
    return Couplings.of(A, frozen_int(np.arange(n + 1)), frozen_int(np.arange(n)))


def dense_of(strength: Couplings) -> np.ndarray:
    n = len(strength.size)
    return sparse.csr_array((strength.weight, strength.to, strength.graph), shape=(n, n)).toarray()


def greedy_twin(w: np.ndarray, s: np.ndarray, theta: float) -> tuple[list[int], int]:
    """In dense algebra, one rule after the other."""
    n, count = len(s), 0
    strong = w > theta * np.maximum(s[:, None], s)
    unneeded = np.abs(w).sum(axis=1) <= 0.1 * s
    first = {}
    for i in range(n):
        if not unneeded[i] and not (w[i] > theta * s[i]).any():
            first[i], count = count, count + 1
    for i in range(n):
        friends = [j for j in np.flatnonzero(strong[i]) if not unneeded[j]]
        if i not in first and not unneeded[i] and friends and not any(j in first for j in friends):
            first |= dict.fromkeys([i, *friends], count)
            count += 1
    labels = dict(first)
    for i in range(n):
        held = [j for j in range(n) if j in first and w[i, j] > theta * s[i]]
        if i not in first and not unneeded[i] and held:
            labels[i] = first[max(held, key=lambda j: w[i, j])]
    for i in range(n):
        if i not in labels and not unneeded[i]:
            free = [j for j in np.flatnonzero(strong[i]) if j not in labels and not unneeded[j]]
            labels |= dict.fromkeys([i, *free], count)
            count += 1
    return [labels.get(i, -1) for i in range(n)], count


@pytest.mark.parametrize("seed", range(8))
def test_greedy_aggregates(seed: int) -> None:
    A = random_matrix(120, seed)
    strength = scalar_couplings(A)
    off = -(A.toarray() - np.diag(A.diagonal()))
    assert np.array_equal(dense_of(strength), off)
    assert np.array_equal(strength.size, A.diagonal())
    for theta in (0.0, 0.1, 0.4):
        labels, count = greedy_aggregates(*strength, theta, 0.1)
        assert (labels.tolist(), count) == greedy_twin(off, A.diagonal(), theta)


def test_a_path_is_cut_into_threes() -> None:
    A = canonical(sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(8, 8)))
    labels, count = greedy_aggregates(*scalar_couplings(A), 0.15, 0.1)
    assert labels.tolist() == [0, 0, 1, 1, 1, 2, 2, 2]
    assert count == 3


def test_parts_of_large_diagonal_do_not_share_an_unknown() -> None:
    """Two stiff cells with a soft one between: it joins one of them, and they stay apart."""
    dense = np.diag([1e6, 4.0, 1e6])
    dense[0, 1] = dense[1, 0] = dense[1, 2] = dense[2, 1] = -2.0
    labels, _ = greedy_aggregates(*scalar_couplings(canonical(sparse.csr_array(dense))), 0.15, 0.1)
    assert labels.tolist() == [-1, 0, -1]  # the stiff ones are next to solved as they are
    dense[0, 0] = dense[2, 2] = 19.0
    labels, _ = greedy_aggregates(*scalar_couplings(canonical(sparse.csr_array(dense))), 0.15, 0.1)
    assert labels.tolist() == [0, 0, 1]


@pytest.mark.parametrize("seed", range(5))
def test_labels_are_split_where_strong_couplings_end(seed: int) -> None:
    A, given = random_matrix(150, seed), np.random.default_rng(seed).integers(0, 12, 150)
    w, s = -(A.toarray() - np.diag(A.diagonal())), A.diagonal()
    inside = given[:, None] == given
    strong = inside & (w > 0.1 * np.maximum(s[:, None], s))
    _, piece = connected_components(sparse.csr_array(strong), directed=False)
    expected = piece.copy()
    for i in np.flatnonzero(~strong.any(axis=1)):
        held = [j for j in range(150) if inside[i, j] and strong[j].any() and w[i, j] > 0.1 * s[i]]
        if held:
            expected[i] = piece[max(held, key=lambda j: w[i, j])]
    labels, count = split_labels(*scalar_couplings(A), 0.1, frozen_int(given))
    pairs = set(zip(labels.tolist(), expected.tolist(), strict=True))
    assert len(pairs) == count == len(set(expected)) == labels.max() + 1
    assert labels[0] == 0


def test_couplings_of_blocks_are_frobenius_norms() -> None:
    A, offsets = random_matrix(60, 3), frozen_int([0, 1, 4, 6, 20, 33, 60])
    strength = Couplings.of(A, offsets, frozen_int(np.repeat(np.arange(6), np.diff(offsets))))
    norms = np.array(
        [[np.linalg.norm(A.toarray()[a:b, c:d]) for c, d in pairwise(offsets)] for a, b in pairwise(offsets)]
    )
    assert np.allclose(strength.size, np.diag(norms))
    assert np.allclose(dense_of(strength), norms - np.diag(np.diag(norms)))


def test_weak_blocks_are_taken_out() -> None:
    A, offsets = random_matrix(60, 4), frozen_int(np.arange(0, 61, 3))
    part = np.repeat(np.arange(20), 3)
    strength = Couplings.of(A, offsets, frozen_int(part))
    B = np.random.default_rng(0).standard_normal((60, 2))
    indptr, indices, data, left = split_weak(
        A.indptr, A.indices, A.data, offsets, frozen_int(part), *strength, 0.05, frozen_float(B)
    )
    weak = (dense_of(strength) <= 0.05 * strength.size[:, None]) & ~np.eye(20, dtype=bool)
    weak = weak[part][:, part]
    assert weak.any()
    kept = sparse.csr_array((data, indices, indptr), shape=A.shape).toarray()
    assert np.array_equal(kept, np.where(weak, 0.0, A.toarray()))
    assert np.allclose(left, np.where(weak, A.toarray(), 0.0) @ B)


def test_local_bases_drop_what_adds_nothing() -> None:
    rng = np.random.default_rng(1)
    B = rng.standard_normal((9, 3))
    B[4:, 2] = 2.0 * B[4:, 0] - B[4:, 1]
    starts, rows = np.array([0, 1, 4, 9]), np.arange(9)
    Q, R, ranks = local_bases(frozen_int(starts), frozen_int(rows), frozen_float(B))
    assert ranks.tolist() == [1, 3, 2]
    for a, rank in enumerate(ranks):
        mine = slice(starts[a], starts[a + 1])
        assert np.allclose(Q[mine, :rank].T @ Q[mine, :rank], np.eye(rank), atol=1e-14)
        assert np.allclose(Q[mine] @ R[a], B[mine], atol=1e-13)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_gauss_seidel_is_triangular_solution(dtype: type) -> None:
    A = random_matrix(80, 5)
    b = np.random.default_rng(2).standard_normal(80).astype(dtype)
    dense, smoother = A.toarray(), ScalarGaussSeidel(A, dtype)
    x, r = smoother.before(b)
    assert x.dtype == r.dtype == dtype
    tolerance = 1e-10 if dtype is np.float64 else 1e-3
    expected = solve_triangular(dense, b.astype(float), lower=True)
    assert np.abs(x - expected).max() <= tolerance * np.abs(expected).max()
    assert np.abs(r - (b - dense @ expected)).max() <= tolerance * np.abs(dense @ expected).max()
    start = np.random.default_rng(3).standard_normal(80).astype(dtype)
    better = start + solve_triangular(dense, b - dense @ start)
    assert np.allclose(smoother.after(b, start.copy()), better, rtol=tolerance, atol=tolerance)


def test_gauss_seidel_takes_any_sparse_matrix() -> None:
    A = sparse.coo_array(([1.0, 1.0, -1.0, -1.0, 3.0], ([0, 0, 1, 0, 1], [0, 0, 0, 1, 1])))
    kept = A.toarray()
    x, r = ScalarGaussSeidel(A).before(np.array([2.0, 2.0]))
    assert x.tolist() == [1.0, 1.0]
    assert r.tolist() == [1.0, 0.0]
    assert frozen(A.toarray(), float).tolist() == kept.tolist()


def test_gauss_seidel_needs_a_positive_diagonal() -> None:
    with pytest.raises(OptionError, match=r"row 1 of the matrix has 0 \(1 such rows\)"):
        ScalarGaussSeidel(sparse.csr_array([[1.0, 0.0], [0.0, 0.0]]))
