"""Constraints on edges: forbidden edges are removed before a run starts.

Recursion, direct partitions, merging, polishing and fixing then work on a graph without forbidden edges. As
every part is connected, it satisfies the constraints. Constraints on whole parts: ``parts.py``.
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


def remove_forbidden_edges(graph: Graph, constraints: Sequence[Member], there: Graph) -> Graph:
    """Return the graph ``there`` without the edges that constraints forbid.

    The constraints receive ``graph``, with edges equal to the edges in ``there``.

    Raises
    ------
    PluginError
        If a constraint misbehaves.
    """
    edge_rules = [member for member in constraints if callable(getattr(member.tool, "forbidden", None))]
    if not edge_rules:
        return there
    forbidden = np.zeros(len(graph.indices), bool)
    for member in edge_rules:
        forbidden |= forbidden_by(member, graph)
    return there.without_edges(forbidden)


def raise_counts(
    graph: Graph, allowed: Graph, constraints: Sequence[Member], goals: Sequence[Goal]
) -> tuple[Goal, ...]:
    """Return the goals, with part counts from mean sizes raised as far as the bounds on parts require.

    Measures are taken from ``graph``, connections from ``allowed``.

    Raises
    ------
    OptionError
        If an exact part count is smaller.
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
        raise OptionError(f"too few parts, {goal.parts}: {title} needs at least {fewest}")
    return replace(goal, parts=fewest)


@contextmanager
def naming_constraints(constraints: Sequence[Member]) -> Iterator[None]:
    """Context manager that names the constraints in the error about too few parts."""
    try:
        yield
    except TooFewPartsError as error:
        if not constraints:
            raise
        titles = ", ".join(member.title for member in constraints)
        raise OptionError(
            f"too few parts, {error.parts}: the constraints ({titles}) divide the mesh into "
            f"{error.components} components, and each needs at least one part"
        ) from None


def forbidden_by(member: Member, graph: Graph) -> Mask:
    """Return a mask ``(m,)`` of the edges that a constraint forbids, with both directions of each edge."""
    # 1. Check shape and dtype of the result.
    with attributed(member.title):
        mask = plain_array(member.tool.forbidden(graph), "the result of forbidden", PluginError)
    shape = graph.indices.shape
    mask = mask if mask.size else np.zeros(0, bool)  # an empty list has no type
    if mask.shape != shape or mask.dtype != bool:
        raise PluginError(
            f"{member.title}: forbidden returned shape {mask.shape} of {mask.dtype}, "
            f"expected {shape} of bool, one entry per CSR entry"
        )
    # 2. Check the symmetry: each forbidden entry (i, j) needs the entry (j, i).
    marked = np.flatnonzero(mask)
    row = np.searchsorted(graph.indptr, marked, side="right") - 1
    column = graph.indices[marked].astype(np.int64)
    keys, reverse_keys = row * graph.n + column, column * graph.n + row
    one_way = np.flatnonzero(~np.isin(keys, reverse_keys))
    if len(one_way):
        i, j = int(row[one_way[0]]), int(column[one_way[0]])
        raise PluginError(
            f"{member.title}: forbidden has the edge from cell {i} to cell {j}, but not from {j} to {i}"
        )
    return mask
