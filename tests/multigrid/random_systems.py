"""Symmetric positive definite systems for multigrid tests."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import sparse

from agglo_core import samples
from agglo_core.multigrid import build_stack, injection
from agglo_core.multigrid.stack import LevelStack

__all__ = ["block_diagonal", "mesh_matrix", "random_system", "two_level"]


def random_system(n: int) -> sparse.csr_array:
    """Return a random sparse matrix ``(n, n)``."""
    R = sparse.random_array((n, n), density=min(1.0, 4 / n), rng=np.random.default_rng(20261122))
    return sparse.csr_array(R @ R.T + sparse.eye_array(n))


def block_diagonal(A: sparse.csr_array, offsets: np.ndarray) -> np.ndarray:
    """Return the diagonal blocks in an otherwise empty matrix."""
    D = np.zeros(A.shape)
    for a, b in pairwise(offsets):
        D[a:b, a:b] = A[[*range(a, b)]][:, [*range(a, b)]].toarray() if b > a else 0.0
    return D


def mesh_matrix(cells: int, width: int = 1) -> sparse.csr_array:
    """Return fluxes between the cells of a Voronoi mesh, with ``width`` coupled unknowns per cell."""
    mesh = samples.voronoi(cells, seed=20261122)
    links = sparse.csr_array(mesh.graph.to_scipy())
    A = sparse.diags_array(links.sum(axis=1) + 1e-3 * links.mean()) - links
    coupling = np.eye(width) + 0.3 * (np.ones((width, width)) - np.eye(width))
    return sparse.csr_array(sparse.kron(A, coupling))


def two_level(A: sparse.csr_array, width: int, smoother: object, **more: object) -> LevelStack:
    """Return a stack of two levels, with four neighbouring parts per coarse part."""
    parts = A.shape[0] // width
    return build_stack(
        A, np.arange(0, A.shape[0] + 1, width), [injection(np.arange(parts) // 4, width)], smoother, **more
    )  # type: ignore[arg-type]
