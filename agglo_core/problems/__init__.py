"""Boundary value problems and linear systems, their solutions, and protocols of discretisations."""

from agglo_core.problems.choosing import discretisation_of, named_problem, read_problem, require_accepted
from agglo_core.problems.diffusion import Diffusion
from agglo_core.problems.discretisation import Discretisation, Field, Problem, Quadrature, Samples
from agglo_core.problems.elasticity import Elasticity, VectorField
from agglo_core.problems.evolution import evolve
from agglo_core.problems.linear import Linear
from agglo_core.problems.multigrid_level import Coarsening, CoarseSpace, MultigridLevel, Patches
from agglo_core.problems.newton import newton
from agglo_core.problems.solution import Lifting, Solution
from agglo_core.problems.solving import solve
from agglo_core.problems.system import System

__all__ = [
    "CoarseSpace",
    "Coarsening",
    "Diffusion",
    "Discretisation",
    "Elasticity",
    "Field",
    "Lifting",
    "Linear",
    "MultigridLevel",
    "Patches",
    "Problem",
    "Quadrature",
    "Samples",
    "Solution",
    "System",
    "VectorField",
    "discretisation_of",
    "evolve",
    "named_problem",
    "newton",
    "read_problem",
    "require_accepted",
    "solve",
]
