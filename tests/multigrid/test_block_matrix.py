"""Sweeps through matrices in blocks, against dense formulas."""

from __future__ import annotations

import numpy as np
import pytest
from multigrid.random_systems import block_diagonal, random_system
from scipy import sparse

from agglo_core.arrays import frozen_float, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid import BlockMatrix, block_inverses, block_matrix
from agglo_core.multigrid.kernels.block_sweeps import both_products, clear_tiny, invert_blocks
from agglo_core.multigrid.matrices.block_product import BlockProduct, fast_product

EQUAL = [np.full(20, width) for width in (1, 3, 17)]  # 17 is wider than any kernel with a constant width
UNEQUAL = [np.array([2, 0, 5, 1, 3, 0, 4, 4])]
PRECISIONS = [(np.float64, 1e-12), (np.float32, 2e-5)]


def slow_sweep(A: np.ndarray, offsets: np.ndarray, b: np.ndarray, x: np.ndarray, order: int) -> np.ndarray:
    """Block Gauss–Seidel, part by part."""
    x = x.copy()
    for p in range(len(offsets) - 1)[::order]:
        own = slice(offsets[p], offsets[p + 1])
        x[own] += np.linalg.solve(A[own, own], b[own] - A[own] @ x)
    return x


@pytest.fixture(params=[*EQUAL, *UNEQUAL], ids=lambda sizes: f"{min(sizes)} to {max(sizes)}")
def system(request: pytest.FixtureRequest) -> tuple[sparse.csr_array, np.ndarray]:
    offsets = np.concatenate([[0], np.cumsum(request.param)])
    return random_system(int(offsets[-1])), offsets


@pytest.mark.parametrize(("dtype", "close"), PRECISIONS)
def test_sweeps_are_those_of_the_formula(system, dtype: type, close: float) -> None:
    A, offsets = system
    dense, ready = A.toarray(), block_matrix(A, offsets, dtype)
    b, x = np.random.default_rng(20261122).standard_normal((2, len(dense)))
    for order, sweep in ((1, ready.forward), (-1, ready.backward)):
        wanted = slow_sweep(dense, offsets, b, slow_sweep(dense, offsets, b, x, order), order)
        made = sweep(b.astype(dtype), x.astype(dtype), 2)
        assert made.dtype == dtype
        assert made == pytest.approx(wanted, abs=close * abs(wanted).max())


@pytest.mark.parametrize(("dtype", "close"), PRECISIONS)
@pytest.mark.parametrize("sweeps", [1, 3])
def test_from_zero_the_residual_comes_along(system, sweeps: int, dtype: type, close: float) -> None:
    A, offsets = system
    b = np.random.default_rng(20261122).standard_normal(A.shape[0])
    wanted = np.zeros(len(b))
    for _ in range(sweeps):
        wanted = slow_sweep(A.toarray(), offsets, b, wanted, 1)
    x, r = block_matrix(A, offsets, dtype).forward_from_zero(b.astype(dtype), sweeps)
    assert x.dtype == r.dtype == dtype
    assert x == pytest.approx(wanted, abs=close * abs(wanted).max())
    assert r == pytest.approx(b - A @ wanted, abs=close * abs(b).max())


def test_matrix_and_inverses_are_what_they_say(system) -> None:
    A, offsets = system
    ready, v = block_matrix(A, offsets), np.random.default_rng(20261122).standard_normal(A.shape[0])
    assert isinstance(ready, BlockMatrix)
    assert ready.shape == A.shape
    assert ready.nnz >= A.nnz
    assert ready @ v == pytest.approx(A @ v)
    assert ready.inverses.toarray() == pytest.approx(np.linalg.inv(block_diagonal(A, offsets)))
    assert block_inverses(A, offsets).format == ("bsr" if len(set(np.diff(offsets))) == 1 else "csr")


def test_what_is_given_stays_as_it_is(system) -> None:
    A, offsets = system
    b = np.ones(A.shape[0])
    b.flags.writeable = False
    kept = A.copy()
    ready = block_matrix(A, offsets)
    ready.forward_from_zero(b)
    ready.forward(b, np.zeros(len(b)))
    assert (kept != A).nnz == 0


def test_storage_does_not_matter() -> None:
    A, offsets = random_system(12), np.arange(0, 13, 3)
    b = np.random.default_rng(20261122).standard_normal(12)
    wanted = block_matrix(A, offsets).forward_from_zero(b)[0]
    twice = sparse.coo_array((np.tile(A.data / 2, 2), np.tile(A.tocoo().coords, 2)), shape=A.shape)
    shuffled = sparse.csr_array(
        (A.data[::-1].copy(), A.indices[::-1].copy(), A.indptr[-1] - A.indptr[::-1]), shape=A.shape
    )[::-1]
    for stored in (sparse.bsr_array(A, blocksize=(3, 3)), sparse.csc_array(A), twice, shuffled):
        assert block_matrix(stored, offsets).forward_from_zero(b)[0] == pytest.approx(wanted, rel=1e-12)


def test_single_precision_has_no_entries_that_vanish_beside_others() -> None:
    A = sparse.csr_array([[1e3, 1e-25, 0.0], [1e-25, 1.0, 1e-10], [0.0, 1e-10, 1.0]])
    single, double = (block_matrix(A, np.arange(4), dtype).matrix for dtype in (np.float32, np.float64))
    assert single.toarray()[0, 1] == 0.0
    assert single.toarray()[1, 2] == np.float32(1e-10)
    assert double.toarray()[0, 1] == 1e-25


@pytest.mark.parametrize("width", [1, 3])
def test_a_block_that_is_not_positive_definite_is_named(width: int) -> None:
    A = random_system(8 * width).tolil()
    A[3 * width, 3 * width] = -1.0
    with pytest.raises(np.linalg.LinAlgError, match=f"part 3, unknowns {3 * width}:{4 * width}"):
        block_matrix(A.tocsr(), np.arange(0, 8 * width + 1, width))
    A[3 * width, 3 * width] = np.nan
    with pytest.raises(np.linalg.LinAlgError, match="part 3"):
        block_inverses(A.tocsr(), np.arange(0, 8 * width + 1, width))


def test_singular_blocks_are_found_despite_rounding() -> None:
    block = np.full((3, 3), 1.0 / 3.0)
    assert invert_blocks(frozen_int([0, 3]), block.ravel()) == 0


def test_what_does_not_fit_is_refused() -> None:
    A = random_system(6)
    for offsets in ([0, 3], [0, 3, 7], [1, 6], [0, 4, 2, 6], [0]):
        with pytest.raises(OptionError, match="block_offsets must increase"):
            block_matrix(A, np.array(offsets))
    with pytest.raises(OptionError, match="must be symmetric"):
        block_matrix(A + sparse.csr_array(([0.1], ([0], [5])), shape=A.shape), np.arange(7))
    with pytest.raises(OptionError, match="float32 or float64; given float16"):
        block_matrix(A, np.arange(7), np.float16)


@pytest.mark.parametrize("width", [1, 3])
def test_products_both_ways_and_tiny_entries(width: int) -> None:
    rng = np.random.default_rng(width)
    full = rng.standard_normal((5 * width, 5 * width)) * np.kron(
        rng.random((5, 5)) < 0.6, np.ones((width,) * 2)
    )
    A, v = sparse.bsr_array(full, blocksize=(width, width)), rng.standard_normal(5 * width)
    pattern = frozen_index(A.indptr), frozen_index(A.indices)
    there, back = both_products(*pattern, frozen_float(A.data), frozen_float(v))
    assert there == pytest.approx(full @ v)
    assert back == pytest.approx(full.T @ v)
    values = np.array([1.0, -1e-23, 1e-21, 0.0, -2.0])
    clear_tiny(values, 1e-22)
    assert values.tolist() == [1.0, 0.0, 1e-21, 0.0, -2.0]


@pytest.mark.parametrize("width", [1, 3, 17])
def test_swift_products_are_those_of_scipy(width: int) -> None:
    rng = np.random.default_rng(width)
    A = sparse.random_array((8 * width, 8 * width), density=0.3, rng=rng).tobsr((width, width))
    x = rng.standard_normal((8 * width, 2))
    assert isinstance(fast_product(A), BlockProduct) == (1 < width < 17)
    assert np.allclose(fast_product(A) @ x[:, 0], A @ x[:, 0], atol=1e-12)
    assert np.allclose(fast_product(A) @ x, A @ x, atol=1e-12)
    assert fast_product(A.tocsr()).format == "csr"
    assert fast_product(A.astype(np.float32)).dtype == np.float32
