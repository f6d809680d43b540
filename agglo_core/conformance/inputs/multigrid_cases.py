"""Test cases for multigrid components: small positive definite systems with a coarser level."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.graph import Graph
from agglo_core.problems import Coarsening, MultigridLevel, Patches


def levels() -> list[Case]:
    """Return two-level Poisson test cases for smoothers, with one or three unknowns per cell.

    The matrix is a slightly shifted graph Laplacian; ``x`` is random and not a solution. One level has a
    coarse correction.
    """
    squares = small_meshes.grid(8, 8)
    jittered = small_meshes.grid(9, 7, jitter=0.2)
    row, column = np.divmod(np.arange(64), 8)
    fours = frozen_int(row // 2 * 4 + column // 2)
    sevens = frozen_int(np.arange(63) // 9)
    named_levels = {
        "squares": multigrid_level(squares.graph, fours, corrected=False),
        "squares with a coarse correction": multigrid_level(squares.graph, fours, corrected=True),
        "quadrilaterals": multigrid_level(jittered.graph, sevens, corrected=False),
        "three unknowns per cell": multigrid_level(squares.graph, fours, per_cell=3, corrected=False),
    }
    return [question(name, level) for name, level in named_levels.items()]


def single_unknown() -> list[Case]:
    """Return a test case for smoothers with a single unknown."""
    graph = small_meshes.grid(1, 1).graph
    return [question("one unknown", multigrid_level(graph, frozen_int([0]), corrected=False))]


def multigrid_level(
    graph: Graph, labels: Int, *, per_cell: int = 1, corrected: bool, shift: float = 0.05
) -> MultigridLevel:
    """Return a finest multigrid level whose coarse unknowns are the parts of ``labels``.

    Each patch is a cell with its neighbours.
    """
    # Shifted graph Laplacian and piecewise constant prolongation, repeated for the unknowns of a cell.
    adjacency = sparse.csr_array(graph.to_scipy())
    scalar = sparse.diags_array(adjacency.sum(axis=1) + shift) - adjacency
    inject = sparse.csr_array((np.ones(graph.n), (np.arange(graph.n), labels)))
    A = sparse.csr_array(sparse.kron(scalar, _coupling(per_cell)))
    P = sparse.csr_array(sparse.kron(inject, sparse.eye_array(per_cell)))
    offsets = frozen_int(np.arange(graph.n + 1) * per_cell)
    solve = splu(sparse.csc_array(P.T @ A @ P)).solve

    def correction(residual: Float) -> Float:
        return np.asarray(P @ solve(P.T @ residual))

    # Patches from the rows of adjacency plus identity.
    cells = frozen_int(np.arange(graph.n))
    around = sparse.csr_array(adjacency + sparse.eye_array(graph.n))
    patches = Patches(frozen_int(around.indptr), frozen_int(around.indices))
    return MultigridLevel(A, A, offsets, cells, P, correction if corrected else None, 2, patches)


def _coupling(width: int) -> Float:
    """Return a symmetric positive definite matrix ``(width, width)`` that couples the unknowns of a cell."""
    return np.eye(width) + 0.05 * (np.ones((width, width)) - np.eye(width))


def question(name: str, level: MultigridLevel) -> Case:
    """Return the test case to smooth a random ``x`` on a multigrid level."""
    n = level.A.shape[0]
    x = np.random.default_rng(n).standard_normal(n)
    b = np.cos(np.arange(n) + 1.0)
    return Case(name, (level, frozen_float(b), frozen_float(x)))


PARTS: Final = ("transfer", "coarse_operator", "coarse_solver")
"""Kinds with cases in this module."""


def coarsenings(kind: str) -> list[Case]:
    """Return test cases that coarsen a shifted graph Laplacian with one or three unknowns per cell."""
    squares, jittered = small_meshes.grid(8, 8), small_meshes.grid(9, 7, jitter=0.2)
    row, column = np.divmod(np.arange(64), 8)
    fours = frozen_int(row // 2 * 4 + column // 2)
    steps = {
        "squares": _step(squares.graph, fours, 1),
        "quadrilaterals": _step(jittered.graph, frozen_int(np.arange(63) // 9), 1),
        "three unknowns per cell": _step(squares.graph, fours, 3),
    }
    return [_question(kind, name, step) for name, step in steps.items()]


def one_part(kind: str) -> list[Case]:
    """Return degenerate coarsenings: of a single cell, and of a mesh into a single part."""
    cell, squares = small_meshes.grid(1, 1).graph, small_meshes.grid(4, 3).graph
    steps = {
        "one unknown": _step(cell, frozen_int([0]), 1),
        "all in one part": _step(squares, frozen_int(np.zeros(12)), 1),
    }
    return [_question(kind, name, step) for name, step in steps.items()]


def _question(kind: str, name: str, step: Coarsening) -> Case:
    if kind == "coarse_solver":
        return Case(name, (step.A, frozen_float(np.cos(np.arange(step.A.shape[0]) + 1.0))))
    return Case(name, (step,) if kind == "transfer" else (step, step.injected))


def _step(graph: Graph, labels: Int, width: int) -> Coarsening:
    level = multigrid_level(graph, labels, per_cell=width, corrected=False)
    A, P = (sparse.bsr_array(matrix, blocksize=(width, width)) for matrix in (level.A, level.P))
    near_null = np.kron(np.ones((graph.n, 1)), np.eye(width))
    cell_labels = frozen_int(np.arange(graph.n))

    def rediscretised() -> Any:
        return sparse.csr_array(0.9 * (P.T @ (A @ P)))

    return Coarsening(
        A, level.block_offsets, cell_labels, labels, labels, frozen_float(near_null), P, rediscretised
    )
