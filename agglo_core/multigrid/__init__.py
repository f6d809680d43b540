"""Multigrid on agglomerates: stacks of levels, cycles, and what they are made of."""

from agglo_core.multigrid.block_scaling import block_scaled
from agglo_core.multigrid.cycle import cycle
from agglo_core.multigrid.patch_smoother import AdditivePatches, VertexPatches
from agglo_core.multigrid.patches import vertex_patches
from agglo_core.multigrid.smoothed import galerkin, smoothed_prolongation
from agglo_core.multigrid.stack import Level, LevelSmoother, LevelStack

__all__ = [
    "AdditivePatches",
    "Level",
    "LevelSmoother",
    "LevelStack",
    "VertexPatches",
    "block_scaled",
    "cycle",
    "galerkin",
    "smoothed_prolongation",
    "vertex_patches",
]
