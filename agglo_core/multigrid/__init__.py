"""Multigrid methods on agglomerates: levels, cycles, and their components."""

from agglo_core.multigrid.coarse_solve import COARSE_SOLVERS, coarse_solver, direct_solver, symmetric_lu
from agglo_core.multigrid.coarsening.aggregation import aggregation_stack, blockwise, pointwise
from agglo_core.multigrid.coarsening.along_flow import downstream_order, flow_stack, paired_levels
from agglo_core.multigrid.coarsening.classical import CoarseFirst, classical_stack
from agglo_core.multigrid.coarsening.near_null import smoothed_near_null
from agglo_core.multigrid.coarsening.smoothed import smoothed_prolongation
from agglo_core.multigrid.coarsening.strong_groups import strong_groups
from agglo_core.multigrid.coarsening.transfers import parents
from agglo_core.multigrid.composition import Composition
from agglo_core.multigrid.cycle import cycle
from agglo_core.multigrid.krylov.gcr import gcr
from agglo_core.multigrid.krylov.pcg import pcg, pcg_columns
from agglo_core.multigrid.matrices.block_matrix import BlockMatrix, block_inverses, block_matrix
from agglo_core.multigrid.matrices.block_scaling import block_scaled
from agglo_core.multigrid.matrices.galerkin import build_stack, galerkin, injection
from agglo_core.multigrid.named_parts import CoarseOperator, CoarseSolver, Transfer, part
from agglo_core.multigrid.smoothers.adapted import Adapted, adapted
from agglo_core.multigrid.smoothers.additive_schwarz import additive_schwarz
from agglo_core.multigrid.smoothers.level_smoothers import (
    SMOOTHERS,
    BlockJacobi,
    Chebyshev,
    GaussSeidel,
    smoother_setup,
)
from agglo_core.multigrid.smoothers.ordered import OrderedGaussSeidel
from agglo_core.multigrid.smoothers.patch_smoother import VertexPatches
from agglo_core.multigrid.smoothers.patches import MAX_PARTS, joined_patches, vertex_patches
from agglo_core.multigrid.smoothers.scalar_gauss_seidel import ScalarGaussSeidel
from agglo_core.multigrid.smoothers.spectrum import largest_eigenvalue
from agglo_core.multigrid.stack import Level, LevelSmoother, LevelStack
from agglo_core.multigrid.system_levels import SystemLevels, build_levels, is_classical, stack_of_system
from agglo_core.problems.residuals.row_scales import lifted, row_measure

__all__ = [
    "COARSE_SOLVERS",
    "MAX_PARTS",
    "SMOOTHERS",
    "Adapted",
    "BlockJacobi",
    "BlockMatrix",
    "Chebyshev",
    "CoarseFirst",
    "CoarseOperator",
    "CoarseSolver",
    "Composition",
    "GaussSeidel",
    "Level",
    "LevelSmoother",
    "LevelStack",
    "OrderedGaussSeidel",
    "ScalarGaussSeidel",
    "SystemLevels",
    "Transfer",
    "VertexPatches",
    "adapted",
    "additive_schwarz",
    "aggregation_stack",
    "block_inverses",
    "block_matrix",
    "block_scaled",
    "blockwise",
    "build_levels",
    "build_stack",
    "classical_stack",
    "coarse_solver",
    "cycle",
    "direct_solver",
    "downstream_order",
    "flow_stack",
    "galerkin",
    "gcr",
    "injection",
    "is_classical",
    "joined_patches",
    "largest_eigenvalue",
    "lifted",
    "paired_levels",
    "parents",
    "part",
    "pcg",
    "pcg_columns",
    "pointwise",
    "row_measure",
    "smoothed_near_null",
    "smoothed_prolongation",
    "smoother_setup",
    "stack_of_system",
    "strong_groups",
    "symmetric_lu",
    "vertex_patches",
]
