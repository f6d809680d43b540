"""Patch smoothers against dense twins: inverses, sweeps, symmetry, errors."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from agglo_core import samples
from agglo_core.arrays import frozen_float, frozen_index, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid import VertexPatches, joined_patches, vertex_patches
from agglo_core.multigrid.kernels.patch_factors import patch_factors, patch_orders
from agglo_core.multigrid.matrices.block_matrix import in_precision
from agglo_core.multigrid.smoothers.patch_smoother import PatchSmoother
from agglo_core.problems import MultigridLevel, Patches

Array = np.ndarray
FRESH = 20261122


def block_laplacian(width: int, cells: int = 40) -> tuple[sparse.bsr_array, Patches]:
    """A random matrix on the graph of a Voronoi mesh, symmetric and positive definite, and its patches."""
    rng = np.random.default_rng(FRESH)
    mesh = samples.voronoi(cells, seed=FRESH)
    inner = mesh.face_cells[mesh.face_cells[:, 1] >= 0]
    n = mesh.n_cells * width
    A = 0.1 * np.eye(n)
    for i, j in inner:
        both = np.r_[i * width : (i + 1) * width, j * width : (j + 1) * width]
        B = rng.standard_normal((width, 2 * width))
        A[np.ix_(both, both)] += B.T @ B
    return sparse.csr_array(A).tobsr((width, width)), vertex_patches(mesh)


def unknowns(patches: Patches, width: int) -> list[Array]:
    parts = np.split(patches.parts, patches.offsets[1:-1])
    return [(each[:, None] * width + np.arange(width)).ravel() for each in parts]


def slow_sweep(A: Array, b: Array, x: Array, groups: list[Array]) -> Array:
    x = x.copy()
    for u in groups:
        x[u] += np.linalg.solve(A[np.ix_(u, u)], (b - A @ x)[u])
    return x


@pytest.mark.parametrize("overlap", [True, False])
@pytest.mark.parametrize("width", [1, 3])
def test_sweeps_are_those_of_the_slow_twin(width: int, overlap: bool) -> None:
    A, patches = block_laplacian(width)
    if not overlap:
        neighbours = np.stack((patches.parts[:-1], patches.parts[1:]), axis=1)
        patches = joined_patches(neighbours, A.shape[0] // width, most=4)
        assert 1 < np.diff(patches.offsets).max() <= 4
    groups, dense = unknowns(patches, width), A.toarray()
    b, x = np.random.default_rng(FRESH + 1).standard_normal((2, len(dense)))
    smoother = VertexPatches(A, patches)
    first, r = smoother.before(b)
    assert np.allclose(first, slow_sweep(dense, b, np.zeros(len(b)), groups), atol=1e-9)
    assert np.allclose(r, b - dense @ first, atol=1e-9)
    assert np.allclose(smoother.sweep(b, x), slow_sweep(dense, b, x, groups), atol=1e-9)
    assert np.allclose(smoother.after(b, x.copy()), slow_sweep(dense, b, x, groups[::-1]), atol=1e-9)


def test_single_precision_is_close_to_double() -> None:
    A, patches = block_laplacian(3)
    b = np.ones(A.shape[0])
    single, r = VertexPatches(A, patches, np.float32).before(b.astype(np.float32))
    assert single.dtype == r.dtype == np.float32
    assert np.allclose(single, VertexPatches(A, patches).before(b)[0], rtol=1e-3, atol=1e-3)


def test_after_mirrors_before() -> None:
    A, patches = block_laplacian(3, cells=15)
    smoother, n = VertexPatches(A, patches), A.shape[0]
    B = np.stack([smoother.before(e)[0] for e in np.eye(n)], axis=1)
    C = np.stack([smoother.after(e, np.zeros(n)) for e in np.eye(n)], axis=1)
    assert np.allclose(C, B.T, atol=1e-10 * np.abs(B).max())


def test_factors_are_sparse_and_those_of_the_matrix() -> None:
    n, size = 2, 6  # a ring: each part is coupled to two others
    rng = np.random.default_rng(FRESH)
    dense = 4.0 * np.eye(n * size)
    for a, b in ((a, (a + 1) % size) for a in range(size)):
        block = rng.uniform(-0.5, 0.5, (n, n))
        dense[n * a : n * a + n, n * b : n * b + n] = block
        dense[n * b : n * b + n, n * a : n * a + n] = block.T
    A = sparse.csr_array(dense).tobsr((n, n))
    pattern = frozen_int(A.indptr), frozen_index(A.indices)
    offsets, parts = frozen_int([0, size]), frozen_index(np.arange(size))
    order, starts, below = patch_orders(offsets, parts, *pattern)
    assert sorted(order) == list(range(size))
    assert len(below) == 2 * size - 3
    pivots, factors = np.empty((size, n, n)), np.empty((len(below), n, n))
    given = offsets, frozen_index(order), frozen_int(starts), frozen_index(below)
    assert patch_factors(0)(*given, *pattern, frozen_float(A.data), pivots, factors) == -1
    L, D = np.eye(n * size), np.zeros((n * size, n * size))
    for a in range(size):
        own = slice(n * a, n * a + n)
        D[own, own] = np.linalg.inv(pivots[a])
        for h in range(starts[a], starts[a + 1]):
            L[n * below[h] : n * below[h] + n, own] = -factors[h].T
    unknowns = (n * order[:, None] + np.arange(n)).ravel()
    assert np.allclose(L @ D @ L.T, dense[np.ix_(unknowns, unknowns)])


def test_a_patch_of_everything_solves() -> None:
    A, _ = block_laplacian(3, cells=12)
    whole = Patches(np.array([0, 12]), np.arange(12))
    b = np.ones(36)
    x, r = VertexPatches(A, whole).before(b)
    assert np.allclose(A @ x, b, atol=1e-8)
    assert np.abs(r).max() < 1e-8


def test_rounding_drops_what_would_be_denormal() -> None:
    A = sparse.csr_array([[1.0, 1e-30], [1e-30, 2.0]]).tobsr((2, 2))
    assert in_precision(A, np.float32).toarray().tolist() == [[1.0, 0.0], [0.0, 2.0]]
    assert in_precision(A, np.float64) is A


def level(A: sparse.bsr_array, patches: Patches | None, offsets: Array | None = None) -> MultigridLevel:
    n, width = A.shape[0], A.blocksize[0]
    offsets = np.arange(0, n + 1, width) if offsets is None else offsets
    return MultigridLevel(A, A, offsets, np.arange(n // width), None, None, 2, patches)


def test_the_component_sweeps_forth_and_back() -> None:
    A, patches = block_laplacian(3)
    groups, dense = unknowns(patches, 3), A.toarray()
    b = np.ones(len(dense))
    expected = np.zeros(len(b))
    for _ in range(2):
        expected = slow_sweep(dense, b, slow_sweep(dense, b, expected, groups), groups[::-1])
    assert np.allclose(PatchSmoother().setup(level(A, patches))(b, np.zeros(len(b))), expected, atol=1e-9)


def test_what_cannot_be_smoothed_is_refused() -> None:
    A, patches = block_laplacian(3, cells=15)
    with pytest.raises(OptionError, match=r"requires the patches of the level.*level\.patches"):
        PatchSmoother().setup(level(A, None))
    with pytest.raises(OptionError, match="equal numbers of unknowns; given 1 to 44"):
        PatchSmoother().setup(level(A, patches, np.array([0, 1, 45])))
    with pytest.raises(OptionError, match="part 14 of 15 is in no patch"):
        VertexPatches(A, Patches(np.array([0, 14]), np.arange(14)))
    with pytest.raises(OptionError, match="patches contain part 15, but the matrix has only 15 blocks"):
        VertexPatches(A, Patches(np.array([0, 16]), np.arange(16)))
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite on the parts"):
        VertexPatches(sparse.bsr_array(-A), patches)
