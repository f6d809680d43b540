"""Products of matrices in small blocks, against dense ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from agglo_core.multigrid.matrices.block_scaling import block_scaled
from agglo_core.multigrid.matrices.galerkin import block_galerkin, block_matmat, have_kernels


def in_blocks(rows: int, columns: int, width: int, rng: np.random.Generator) -> sparse.bsr_array:
    """Random blocks, some rows without any, columns not sorted."""
    pattern = sparse.random_array((rows, columns), density=0.3, rng=rng, format="csr")
    for i in range(rows):
        own = slice(pattern.indptr[i], pattern.indptr[i + 1])
        pattern.indices[own] = pattern.indices[own][::-1].copy()
    values = rng.standard_normal((pattern.nnz, width, width))
    shape = (rows * width, columns * width)
    return sparse.bsr_array((values, pattern.indices, pattern.indptr), shape=shape)


@pytest.mark.parametrize("width", [3, 16])
def test_products_are_those_of_dense_matrices(width: int) -> None:
    rng = np.random.default_rng(20261123 + width)
    A, P = in_blocks(12, 12, width, rng), in_blocks(12, 5, width, rng)
    assert have_kernels(A, P)
    np.testing.assert_allclose(block_matmat(A, P).toarray(), A.toarray() @ P.toarray(), atol=1e-12)
    coarse, dense = block_galerkin(A, P), P.toarray()
    np.testing.assert_allclose(coarse.toarray(), dense.T @ A.toarray() @ dense, atol=1e-11)
    assert coarse.has_sorted_indices
    assert coarse.blocksize == (width, width)


def test_only_square_blocks_of_one_size_have_kernels() -> None:
    rng = np.random.default_rng(0)
    A, other = in_blocks(4, 4, 2, rng), in_blocks(4, 4, 3, rng)
    wide, tall = in_blocks(4, 4, 17, rng), sparse.bsr_array(np.ones((8, 4)), blocksize=(2, 1))
    assert [have_kernels(A, each) for each in (A, other, tall, A.tocsr(), A.astype(np.float32))] == (
        [True, *[False] * 4]
    )
    assert not have_kernels(wide)


@pytest.mark.parametrize("width", [1, 3, 17])
def test_scaled_blocks_are_identities(width: int) -> None:
    half = in_blocks(9, 9, width, np.random.default_rng(width)).toarray()
    A = sparse.bsr_array(half @ half.T + np.eye(len(half)), blocksize=(width, width))
    scaled = block_scaled(A)
    T = scaled.T.toarray()
    np.testing.assert_allclose(scaled.A.toarray(), T @ A.toarray() @ T.T, atol=1e-10)
    for i in range(0, len(half), width):
        np.testing.assert_allclose(
            scaled.A.toarray()[i : i + width, i : i + width], np.eye(width), atol=1e-11
        )
    np.testing.assert_allclose(scaled.LT.toarray() @ T.T, np.eye(len(half)), atol=1e-10)
