"""Constraints: edges that no part may cross are removed before a run starts.

Recursion, direct partitions, merging, polishing and fixing then work on a graph that knows no such edge,
and every part, being connected, keeps the constraints.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.arrays import Mask
from agglo_core.errors import OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.registry.attribution import Member, attributed

__all__ = ["constrained"]


def constrained(graph: Graph, constraints: Sequence[Member], goals: Sequence[Goal]) -> Graph:
    """The graph without the edges that the constraints forbid; without constraints the graph itself.

    Raises
    ------
    OptionError
        If a constraint asks for anything other than forbidden edges, or a goal is a smaller number of
        parts than the graph then has components.
    PluginError
        If a constraint misbehaves.
    """
    if not constraints:
        return graph
    forbidden = np.zeros(len(graph.indices), bool)
    for member in constraints:
        _check_supported(member)
        forbidden |= _forbidden(member, graph)
    allowed = graph.without_edges(forbidden)
    components = int(allowed.components().max()) + 1
    least = min((goal.parts for goal in goals if isinstance(goal, CountGoal)), default=components)
    if least < components:
        titles = ", ".join(member.title for member in constraints)
        raise OptionError(
            f"too few parts, {least}: with the constraints ({titles}) the mesh falls into {components} "
            "components, and each is a part"
        )
    return allowed


def _check_supported(member: Member) -> None:
    others = [name for name in ("admissible", "finished") if callable(getattr(member.tool, name, None))]
    if others:
        raise OptionError(
            f"{member.title} has {' and '.join(others)}: so far agglomerate supports only forbidden(graph)"
        )


def _forbidden(member: Member, graph: Graph) -> Mask:
    """Forbidden CSR entries ``(m,)``, both directions of each edge."""
    with attributed(member.title):
        given = np.asarray(member.tool.forbidden(graph))
    shape = graph.indices.shape
    if given.shape != shape or given.dtype != bool:
        raise PluginError(
            f"{member.title}: forbidden returned shape {given.shape} of {given.dtype}, "
            f"expected {shape} of bool, one for each CSR entry"
        )
    row = np.repeat(np.arange(graph.n), np.diff(graph.indptr))[given]
    column = graph.indices[given].astype(np.int64)
    there, back = row * graph.n + column, column * graph.n + row
    alone = np.flatnonzero(~np.isin(there, back))
    if len(alone):
        i, j = int(row[alone[0]]), int(column[alone[0]])
        raise PluginError(
            f"{member.title}: forbidden has the edge from cell {i} to cell {j}, but not from {j} to {i}"
        )
    return given
