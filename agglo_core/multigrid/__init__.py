"""Multigrid on agglomerates: stacks of levels, cycles, and what they are made of."""

from agglo_core.multigrid.additive_schwarz import additive_schwarz
from agglo_core.multigrid.aggregation import aggregation_stack
from agglo_core.multigrid.cycle import cycle
from agglo_core.multigrid.direct_solution import direct_solver
from agglo_core.multigrid.scalar_gauss_seidel import ScalarGaussSeidel
from agglo_core.multigrid.stack import Level, LevelSmoother, LevelStack

__all__ = [
    "Level",
    "LevelSmoother",
    "LevelStack",
    "ScalarGaussSeidel",
    "additive_schwarz",
    "aggregation_stack",
    "cycle",
    "direct_solver",
]
