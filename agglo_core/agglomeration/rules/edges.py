"""Constraints: edges that no part may cross are removed before a run starts.

Recursion, direct partitions, merging, polishing and fixing then work on a graph that knows no such edge,
and every part, being connected, keeps the constraints. What they ask of whole parts: ``parts.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal, TooFewPartsError
from agglo_core.arrays import Mask, plain_array
from agglo_core.errors import OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.registry.attribution import Member, attributed


def constrained(graph: Graph, constraints: Sequence[Member], there: Graph) -> Graph:
    """The graph ``there``, of the same edges as ``graph``, without those that constraints forbid.

    Raises
    ------
    PluginError
        If a constraint misbehaves.
    """
    asked = [member for member in constraints if callable(getattr(member.tool, "forbidden", None))]
    if not asked:
        return there
    forbidden = np.zeros(len(graph.indices), bool)
    for member in asked:
        forbidden |= forbidden_by(member, graph)
    return there.without_edges(forbidden)


def bounded_goals(
    graph: Graph, allowed: Graph, constraints: Sequence[Member], goals: Sequence[Goal]
) -> tuple[Goal, ...]:
    """The goals, mean sizes with at least as many parts as bounds on parts need.

    Measures are those of ``graph``, connections those that are ``allowed``.

    Raises
    ------
    OptionError
        If an exact number of parts is smaller.
    """
    bounds = [member for member in constraints if hasattr(member.tool, "fewest")]
    if not bounds or not any(isinstance(goal, CountGoal) for goal in goals):
        return tuple(goals)
    components = allowed.components()
    needs = {member.title: member.tool.fewest(graph, components) for member in bounds}
    title, fewest = max(needs.items(), key=lambda need: need[1])
    return tuple(_at_least(goal, fewest, title) for goal in goals)


def _at_least(goal: Goal, fewest: int, title: str) -> Goal:
    if not isinstance(goal, CountGoal) or goal.parts >= fewest:
        return goal
    if goal.exact:
        raise OptionError(f"too few parts, {goal.parts}: {title} needs {fewest} at least")
    return replace(goal, parts=fewest)


@contextmanager
def naming(constraints: Sequence[Member]) -> Iterator[None]:
    """Let the refusal of a number of parts smaller than that of the components name the constraints."""
    try:
        yield
    except TooFewPartsError as error:
        if not constraints:
            raise
        titles = ", ".join(member.title for member in constraints)
        raise OptionError(
            f"too few parts, {error.parts}: with the constraints ({titles}) the mesh falls into "
            f"{error.components} components, and each is a part"
        ) from None


def forbidden_by(member: Member, graph: Graph) -> Mask:
    """Forbidden CSR entries ``(m,)``, both directions of each edge."""
    with attributed(member.title):
        given = plain_array(member.tool.forbidden(graph), "the result of forbidden", PluginError)
    shape = graph.indices.shape
    if given.shape != shape or given.dtype != bool:
        raise PluginError(
            f"{member.title}: forbidden returned shape {given.shape} of {given.dtype}, "
            f"expected {shape} of bool, one for each CSR entry"
        )
    marked = np.flatnonzero(given)
    row = np.searchsorted(graph.indptr, marked, side="right") - 1
    column = graph.indices[marked].astype(np.int64)
    there, back = row * graph.n + column, column * graph.n + row
    one_way = np.flatnonzero(~np.isin(there, back))
    if len(one_way):
        i, j = int(row[one_way[0]]), int(column[one_way[0]])
        raise PluginError(
            f"{member.title}: forbidden has the edge from cell {i} to cell {j}, but not from {j} to {i}"
        )
    return given
