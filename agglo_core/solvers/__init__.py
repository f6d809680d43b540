"""Direct solver, plain conjugate gradients, and helpers shared with the solvers of plugins."""

from agglo_core.problems.iteration_history import unsolved
from agglo_core.problems.linear import require_cells
from agglo_core.solvers.advice import Kind, advice_after_failure, advice_of_multigrid
from agglo_core.solvers.fine_system import (
    CELLS_PER_PART,
    FineSystem,
    chosen_discretisation,
    chosen_levels,
    default_levels,
    fine_system,
    has_convection,
    own_mesh,
    require_symmetric_problem,
)
from agglo_core.solvers.general_task import GeneralTask
from agglo_core.solvers.linear_task import DiscretisedTask, LinearTask
from agglo_core.solvers.option_checks import (
    chosen,
    require_count,
    require_fraction,
    require_name,
    require_positive,
    require_truth,
    show_options,
)
from agglo_core.solvers.plain_cg import PlainCG
from agglo_core.solvers.residual_measure import ResidualMeasure
from agglo_core.solvers.scaling import data_size, factor_for, matrix_factor, times, unscaled
from agglo_core.solvers.stopwatch import Stopwatch

__all__ = [
    "CELLS_PER_PART",
    "DiscretisedTask",
    "FineSystem",
    "GeneralTask",
    "Kind",
    "LinearTask",
    "PlainCG",
    "ResidualMeasure",
    "Stopwatch",
    "advice_after_failure",
    "advice_of_multigrid",
    "chosen",
    "chosen_discretisation",
    "chosen_levels",
    "data_size",
    "default_levels",
    "factor_for",
    "fine_system",
    "has_convection",
    "matrix_factor",
    "own_mesh",
    "require_cells",
    "require_count",
    "require_fraction",
    "require_name",
    "require_positive",
    "require_symmetric_problem",
    "require_truth",
    "show_options",
    "times",
    "unscaled",
    "unsolved",
]
