"""Solving with somebody's solver: whatever it raises or returns, errors say whose it is."""

from __future__ import annotations

from agglo_core.errors import AggloError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems.problem import Problem
from agglo_core.problems.solution import Solution
from agglo_core.registry.attribution import Member, attributed
from agglo_core.registry.containment import shown

__all__ = ["solved_by"]


def solved_by(solver: Member, problem: Problem, hierarchy: Hierarchy) -> Solution:
    """The solution of a solver.

    Raises
    ------
    AggloError
        What the solver refuses.
    PluginError
        For anything else it raises, or if it returns no Solution.
    """
    with attributed(solver.title, spare=(AggloError,)):
        solution = solver.tool.solve(problem, hierarchy)
    if not isinstance(solution, Solution):
        raise PluginError(f"{solver.title}: solve returned {shown(solution)}, expected a Solution")
    return solution
