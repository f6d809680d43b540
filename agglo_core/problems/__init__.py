"""Problems a solver takes, and what it gives back."""

from agglo_core.problems.diffusion import Diffusion, Field, Linear, Problem, Solution

__all__ = ["Diffusion", "Field", "Linear", "Problem", "Solution"]
