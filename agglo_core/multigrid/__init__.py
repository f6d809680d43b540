"""Multigrid on agglomerates: stacks of levels, cycles, and what they are made of."""

from agglo_core.multigrid.adapted_smoother import Adapted, adapted
from agglo_core.multigrid.block_matrix import BlockMatrix, block_inverses, block_matrix
from agglo_core.multigrid.coarse_solve import COARSE_SOLVERS, coarse_solver
from agglo_core.multigrid.cycle import cycle
from agglo_core.multigrid.galerkin import build_stack, galerkin, injection
from agglo_core.multigrid.level_smoothers import (
    SMOOTHERS,
    BlockJacobi,
    Chebyshev,
    GaussSeidel,
    largest_eigenvalue,
    smoother_setup,
)
from agglo_core.multigrid.stack import Level, LevelSmoother, LevelStack

__all__ = [
    "COARSE_SOLVERS",
    "SMOOTHERS",
    "Adapted",
    "BlockJacobi",
    "BlockMatrix",
    "Chebyshev",
    "GaussSeidel",
    "Level",
    "LevelSmoother",
    "LevelStack",
    "adapted",
    "block_inverses",
    "block_matrix",
    "build_stack",
    "coarse_solver",
    "cycle",
    "galerkin",
    "injection",
    "largest_eigenvalue",
    "smoother_setup",
]
