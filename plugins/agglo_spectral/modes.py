"""Lowest eigenpairs of each block's graph Laplacian: dense in batches, iterative for large blocks.

L x = λ M x with L = D − W, W the edge weights and M the diagonal of masses (fractions of the block, so that
the modes are orthonormal in any units), solved as S z = λ z with S = M^{-1/2} L M^{-1/2}.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from agglo_core.authoring import Float, Graph, Int
from agglo_core.graph.blocks import block_extents, block_shares, principal_frames
from agglo_core.threads import one_blas_thread

# Entries in a stack of dense matrices, 32 MiB: larger stacks need more memory (benchmarks/constants.py)
_BATCH = 2**22
# Shift of the Laplacian relative to the estimated lowest eigenvalue, which makes it regular. A larger shift
# takes more sweeps, a smaller shift loses digits (benchmarks/solid_parts.py quality).
_SHIFT = 1e-3
# Fraction of that estimate below which the matrix is refactorised. A larger value takes more factorisations
# and fewer sweeps (benchmarks/solid_parts.py quality).
_FAR = 0.1
_ROUNDING = 1e-13  # relative to the largest entry: least shift and residual
_RESIDUAL = 1e-8  # relative to the lowest eigenvalue: largest residual of the wanted modes
# Maximum number of subspace iterations; they end at the residual above (benchmarks/constants.py)
_SWEEPS = 200
_WEAKEST = 1e-6  # relative to the mean edge weight in a block: lower bound for weights


def laplacian_modes(level: Graph, count: int, weighted: bool, dense_limit: int) -> tuple[Float, Float]:
    """Return the ``count`` lowest nonconstant eigenpairs of each block's graph Laplacian.

    Parameters
    ----------
    weighted : bool
        Weigh edges by interface over centroid distance and nodes by their weight, so that the modes
        approximate those of −Δu = λu with Neumann conditions on any mesh; otherwise all weights are 1.
    dense_limit : int
        Blocks with at most this many nodes are solved densely.

    Returns
    -------
    values : (B, count) float
        Increasing; infinite if a block has too few nodes.
    modes : (n, count) float
        Orthonormal with respect to the masses, zero where the value is infinite.
    """
    values = np.full((level.n_blocks, count), np.inf)
    modes = np.zeros((level.n, count))
    with one_blas_thread():
        for blocks in _batches(np.diff(level.offsets), dense_limit):
            part = level.take(blocks)
            nodes = np.isin(level.block_ids, blocks, kind="table")
            masses = block_shares(part.weights if weighted else np.ones(part.n), part.block_ids)
            roots = np.sqrt(np.maximum(masses, np.finfo(float).eps))
            solve = _dense if np.diff(part.offsets).max() <= dense_limit else _iterative
            values[blocks], scaled = solve(part, roots, _edge_weights(part, weighted), count)
            modes[nodes] = scaled / roots[:, None]
    return values, modes


def _batches(sizes: Int, dense_limit: int) -> Iterator[Int]:
    """Yield batches of blocks with similar sizes, and each block above ``dense_limit`` nodes alone."""
    yield from np.flatnonzero(sizes > dense_limit)[:, None]
    padded = np.where(sizes <= dense_limit, _padded_sizes(sizes), 0)
    for size in np.unique(padded[padded > 0]):
        blocks = np.flatnonzero(padded == size)
        yield from np.array_split(blocks, -(-len(blocks) * size**2 // _BATCH))


def _padded_sizes(sizes: Int) -> Int:
    """Round block sizes up to dense matrix sizes: 2, 3, 4, 6, 8, 12, 16, ….

    Other blocks have no influence.
    """
    powers = 2 ** np.arange(1, 32)
    steps = np.sort(np.concatenate((powers, powers // 2 * 3)))
    return np.asarray(steps[np.searchsorted(steps, sizes)])


def _edge_weights(level: Graph, weighted: bool) -> Float:
    """Return the edge weights ``(m,)``: interface over centroid distance, both bounded below.

    Without the bound, a block with zero interfaces along a cut would have several constant modes.
    """
    if not weighted:
        return np.ones(len(level.indices))
    owners = np.repeat(np.arange(level.n), np.diff(level.indptr))
    steps = level.centroids[owners] - level.centroids[level.indices]
    distances = np.sqrt((steps**2).sum(axis=1))
    extents = np.sqrt((block_extents(level, level.centroids) ** 2).sum(axis=1))
    floor = (1e-6 * extents)[level.block_ids[owners]]
    distances = np.maximum(distances, floor)
    weights = np.divide(level.interface, distances, out=np.ones_like(distances), where=distances > 0)
    blocks = level.block_ids[owners]
    edges = np.bincount(blocks, minlength=level.n_blocks)
    means = np.bincount(blocks, weights, level.n_blocks) / np.maximum(edges, 1)
    least = np.where(means > 0, _WEAKEST * means, 1.0)  # all weights 1 if all interfaces vanish
    bounded: Float = np.maximum(weights, least[blocks])
    return bounded


def _dense(level: Graph, roots: Float, weights: Float, count: int) -> tuple[Float, Float]:
    """Compute the eigenpairs of blocks from one stack of dense matrices, padded to equal size.

    Padding entries lie above the spectrum.
    """
    # 1. Scale each block by its largest degree
    sizes = np.diff(level.offsets)
    n = int(_padded_sizes(sizes).max())
    owners = np.repeat(np.arange(level.n), np.diff(level.indptr))
    places = np.arange(level.n) - level.offsets[level.block_ids]
    degrees = np.bincount(owners, weights, minlength=level.n) / roots**2
    tops = np.maximum.reduceat(degrees, level.offsets[:-1])
    scales = np.where(tops > 0, tops, 1.0)
    # 2. Fill the stack
    stack = np.zeros((level.n_blocks, n, n))
    stack[:, range(n), range(n)] = 4.0  # the spectrum lies in [0, 2] by Gershgorin, after scaling
    blocks = level.block_ids[owners]
    couplings = weights / (roots[owners] * roots[level.indices] * scales[blocks])
    stack[blocks, places[owners], places[level.indices]] = -couplings
    stack[level.block_ids, places, places] = degrees / scales[level.block_ids]
    # 3. Solve, and mark absent modes
    values, vectors = np.linalg.eigh(stack)
    columns = np.minimum(1 + np.arange(count), n - 1)
    absent = 1 + np.arange(count) >= sizes[:, None]
    modes = vectors[level.block_ids[:, None], places[:, None], columns]
    modes = np.where(absent[level.block_ids], 0.0, modes)
    return np.where(absent, np.inf, values[:, columns] * scales[:, None]), modes


def _iterative(graph: Graph, roots: Float, weights: Float, count: int) -> tuple[Float, Float]:
    """Compute the eigenpairs of one block by inverse subspace iteration.

    It starts from linear and quadratic monomials in the principal coordinates, which rotate with the
    mesh and are close to the lowest modes; nothing is random.
    """
    # 1. Scaled Laplacian
    n = graph.n
    adjacency = sparse.csr_array((weights, graph.indices.astype(np.int64), graph.indptr), shape=(n, n))
    scaling = sparse.diags_array(1.0 / roots)
    degrees = sparse.diags_array(adjacency.sum(axis=1))
    matrix = sparse.csc_array(scaling @ (degrees - adjacency) @ scaling)
    # 2. Starting space
    space = _orthonormal(_monomials(principal_frames(graph)[1]) * roots[:, None], roots)
    lowest, rounding = np.min(np.einsum("ni,ni->i", space, matrix @ space)), _ROUNDING * matrix.max()
    factored = np.inf
    # 3. Inverse iteration with Rayleigh–Ritz projection
    for _ in range(_SWEEPS):
        if lowest < _FAR * factored:  # a shift far above the lowest eigenvalue would slow the iteration down
            shift, factored = max(_SHIFT * lowest, rounding), lowest
            factors = _factors(matrix, shift)
        space = _orthonormal(factors.solve(space), roots)
        image = matrix @ space
        values, rotation = np.linalg.eigh(space.T @ image)
        space = space @ rotation
        residuals = np.linalg.norm(image @ rotation - space * values, axis=0)
        if residuals[:count].max() <= max(_RESIDUAL * values[0], rounding):
            break
        lowest = values[0]
    return values[None, :count], space[:, :count]


def _factors(matrix: sparse.csc_array[Any, Any], shift: float) -> SuperLU:
    """Factorise ``matrix`` + ``shift`` · I, which is positive definite."""
    return splu(
        matrix + shift * sparse.eye_array(matrix.shape[0], format="csc"),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def _orthonormal(space: Float, roots: Float) -> Float:
    """Return an orthonormal basis of the span of the columns, orthogonal to the scaled constant ``roots``."""
    constant = roots / np.linalg.norm(roots)
    space = space - constant[:, None] * (constant @ space)
    basis: Float = np.linalg.qr(space / np.linalg.norm(space, axis=0).clip(min=np.finfo(float).tiny))[0]
    return basis - constant[:, None] * (constant @ basis)


def _monomials(coordinates: Float) -> Float:
    """Return all linear and quadratic monomials in the columns of ``coordinates``."""
    i, j = np.triu_indices(coordinates.shape[1])
    return np.concatenate((coordinates, coordinates[:, i] * coordinates[:, j]), axis=1)
