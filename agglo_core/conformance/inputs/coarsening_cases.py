"""Questions to transfers, coarse operators and coarse solvers: steps from a level to the next coarser one."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy import sparse

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.level_cases import multigrid_level
from agglo_core.graph import Graph
from agglo_core.problems import Coarsening

PARTS: Final = ("transfer", "coarse_operator", "coarse_solver")
"""The kinds that are asked here."""


def coarsenings(kind: str) -> list[Case]:
    """Shifted graph Laplacians of one unknown for each cell and of three, and their agglomerates."""
    squares, jittered = small_meshes.grid(8, 8), small_meshes.grid(9, 7, jitter=0.2)
    row, column = np.divmod(np.arange(64), 8)
    fours = frozen_int(row // 2 * 4 + column // 2)
    asked = {
        "squares": _step(squares.graph, fours, 1),
        "quadrilaterals": _step(jittered.graph, frozen_int(np.arange(63) // 9), 1),
        "three unknowns per cell": _step(squares.graph, fours, 3),
    }
    return [_question(kind, name, step) for name, step in asked.items()]


def one_part(kind: str) -> list[Case]:
    """A level of one cell, and one of which all cells are one part."""
    cell, squares = small_meshes.grid(1, 1).graph, small_meshes.grid(4, 3).graph
    asked = {
        "one unknown": _step(cell, frozen_int([0]), 1),
        "all in one part": _step(squares, frozen_int(np.zeros(12)), 1),
    }
    return [_question(kind, name, step) for name, step in asked.items()]


def _question(kind: str, name: str, step: Coarsening) -> Case:
    if kind == "coarse_solver":
        return Case(name, (step.A, frozen_float(np.cos(np.arange(step.A.shape[0]) + 1.0))))
    return Case(name, (step,) if kind == "transfer" else (step, step.injected))


def _step(graph: Graph, labels: Int, width: int) -> Coarsening:
    level = multigrid_level(graph, labels, per_cell=width, corrected=False)
    A, P = (sparse.bsr_array(each, blocksize=(width, width)) for each in (level.A, level.P))
    near_null = np.kron(np.ones((graph.n, 1)), np.eye(width))
    own = frozen_int(np.arange(graph.n))

    def rediscretised() -> Any:
        return sparse.csr_array(0.9 * (P.T @ (A @ P)))

    return Coarsening(A, level.block_offsets, own, labels, labels, frozen_float(near_null), P, rediscretised)
