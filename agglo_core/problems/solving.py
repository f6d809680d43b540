"""Solving with somebody's solver: whatever it raises or returns, errors say whose it is."""

from __future__ import annotations

from agglo_core.errors import AggloError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems.problem import Problem
from agglo_core.problems.solution import Solution
from agglo_core.progress import Listener, phase, unwrapped
from agglo_core.registry.attribution import Member, attributed
from agglo_core.registry.containment import shown

__all__ = ["solved_by"]


def solved_by(
    solver: Member, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None
) -> Solution:
    """The solution of a solver, which may tell its progress (``tells_progress``).

    Raises
    ------
    AggloError
        What the solver refuses.
    PluginError
        For anything else it raises, or if it returns no Solution.
    """
    with unwrapped(progress) as listen, attributed(solver.title, spare=(AggloError,)):
        if getattr(solver.tool, "tells_progress", False):
            solution = solver.tool.solve(problem, hierarchy, progress=listen)
        else:
            with phase(listen, "solving"):
                solution = solver.tool.solve(problem, hierarchy)
    if not isinstance(solution, Solution):
        raise PluginError(f"{solver.title}: solve returned {shown(solution)}, expected a Solution")
    return solution
