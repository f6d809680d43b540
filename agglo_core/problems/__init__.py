"""Problems a solver takes, and what it gives back."""

from agglo_core.problems.diffusion import Diffusion, Field, Linear, Problem, Solution
from agglo_core.problems.multigrid_level import MultigridLevel

__all__ = ["Diffusion", "Field", "Linear", "MultigridLevel", "Problem", "Solution"]
