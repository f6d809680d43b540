"""Levels of the recipe with a continuous space: cells, vertices and bubbles, then aggregates of vertices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, System
from agglo_core.multigrid import Level, LevelSmoother, LevelStack
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.conforming_space import conforming_space
from agglo_polydg_mg.interim_levels import BlockGaussSeidel, ScalarGaussSeidel, aggregation_stack

_SMALL = 1e-5


def conforming_stack(
    system: System,
    basis: Basis,
    kappa: Float | None = None,
    *,
    labels: Int | None = None,
    smoother: Callable[[Any, Any], LevelSmoother] | None = None,
    bubbles: bool = True,
    dtype: Any = np.float32,
) -> LevelStack:
    A = system.A
    space = conforming_space(basis, kappa, bubbles=bubbles)
    inner = space.n > space.n_vertices
    C = space.galerkin(A, _SMALL if inner else 0.0)
    relax = (smoother or BlockGaussSeidel)(A, dtype)
    levels = [Level(A, system.block_offsets, space.prolongation(dtype), relax)]
    if inner:
        n = space.n_vertices
        P = sparse.csr_array(sparse.eye_array(space.n, n, dtype=dtype))
        levels.append(Level(C.astype(dtype), np.arange(space.n + 1), P, ScalarGaussSeidel(C, dtype)))
        C = sparse.csr_array(C[:n, :n])
    rest = aggregation_stack(C, None, dtype=dtype)
    return LevelStack([*levels, *rest.levels], rest.coarse, dtype)
