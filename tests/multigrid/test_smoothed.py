"""Smoothed prolongations, Galerkin products, eigenvalue estimates and scaled blocks against dense algebra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from agglo_core.multigrid import block_scaled, galerkin, smoothed_prolongation
from agglo_core.multigrid.smoothers.spectrum import largest_eigenvalue

Array = np.ndarray
FRESH = 20261122


def chain(width: int, cells: int) -> sparse.bsr_array:
    """A random symmetric positive definite matrix on a path of cells, diagonal blocks of uneven size."""
    rng = np.random.default_rng(FRESH)
    n = cells * width
    A = 0.1 * np.eye(n)
    for c in range(cells - 1):
        own = slice(c * width, (c + 2) * width)
        B = rng.standard_normal((width, 2 * width))
        A[own, own] += B.T @ B
    sizes = 10.0 ** rng.uniform(-3, 3, n)
    return sparse.csr_array(A * np.outer(sizes, sizes)).tobsr((width, width))


def injection(width: int, cells: int) -> sparse.bsr_array:
    """Random blocks, three cells to a part."""
    blocks = np.random.default_rng(FRESH + 1).standard_normal((cells, width, width))
    places = (np.arange(cells) // 3).astype(np.int32), np.arange(cells + 1, dtype=np.int32)
    return sparse.bsr_array((blocks, *places), shape=(cells * width, cells // 3 * width))


@pytest.mark.parametrize("width", [1, 3])
def test_a_smoothed_prolongation_is_the_formula(width: int) -> None:
    A, P = chain(width, 12), injection(width, 12)
    dense = A.toarray()
    D = np.kron(np.eye(12), np.ones((width, width))) * dense
    steps = np.linalg.solve(D, dense)
    largest = largest_eigenvalue(A, lambda r: np.linalg.solve(D, r))
    expected = P.toarray() - 1.2 / largest * steps @ P.toarray()
    found = smoothed_prolongation(A, P, 1.2)
    assert np.allclose(found.toarray(), expected, atol=1e-9 * np.abs(expected).max())
    assert found.blocksize == (width, width)
    assert found.has_sorted_indices
    coarse = galerkin(A, found).toarray()
    assert np.allclose(coarse, expected.T @ dense @ expected, atol=1e-9 * np.abs(coarse).max())


def test_the_largest_eigenvalue_is_found_from_below() -> None:
    A = sparse.diags_array(np.linspace(1.0, 7.0, 200)).tocsr()
    assert largest_eigenvalue(A, lambda r: r, 12) == pytest.approx(7.0, rel=0.03)
    assert largest_eigenvalue(A, lambda r: r, 12) <= 7.0
    scaled = largest_eigenvalue(A / 3.0, lambda r: r)
    assert largest_eigenvalue(A, lambda r: r / 3.0) == pytest.approx(scaled, rel=1e-14)
    assert largest_eigenvalue(5.0 * sparse.eye_array(4, format="csr"), lambda r: r) == pytest.approx(5.0)
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        largest_eigenvalue(-A, lambda r: r)


@pytest.mark.parametrize("width", [1, 3])
def test_scaled_blocks_are_identities_and_solve_the_same_system(width: int) -> None:
    A = chain(width, 9)
    dense = A.toarray()
    scaled = block_scaled(A)
    B, T = scaled.A.toarray(), scaled.T.toarray()
    on = np.kron(np.eye(9), np.ones((width, width)))
    assert np.allclose(on * B, np.eye(9 * width), atol=1e-9)
    assert np.allclose(B, T @ dense @ T.T, atol=1e-9 * np.abs(B).max())
    assert np.allclose(scaled.LT.toarray() @ T.T, np.eye(9 * width), atol=1e-9)
    assert (np.tril(T) * on == T).all()
    D = dense[:width, :width]
    assert np.allclose(T[:width, :width], np.linalg.inv(np.linalg.cholesky(D)), rtol=1e-6)


def test_scaled_matrices_need_no_second_scaling() -> None:
    A, P = block_scaled(chain(3, 12)).A, injection(3, 12)
    once = smoothed_prolongation(A, P, scaled=True).toarray()
    assert np.allclose(once, smoothed_prolongation(A, P).toarray(), rtol=1e-6, atol=1e-8)


def test_a_block_that_is_not_positive_definite_is_named() -> None:
    A = sparse.diags_array([1.0, 1.0, 1.0, 1.0, 0.0, 1.0]).tobsr((3, 3))
    with pytest.raises(np.linalg.LinAlgError, match="block of part 1"):
        block_scaled(A)
