"""Multigrid on agglomerates: stacks of levels, cycles, and what they are made of."""

from agglo_core.multigrid.cycle import cycle
from agglo_core.multigrid.krylov import pcg, pcg_columns
from agglo_core.multigrid.stack import Level, LevelSmoother, LevelStack

__all__ = ["Level", "LevelSmoother", "LevelStack", "cycle", "pcg", "pcg_columns"]
