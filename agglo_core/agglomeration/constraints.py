"""Constraints: edges that no part may cross are removed before a run starts.

Recursion, direct partitions, merging, polishing and fixing then work on a graph that knows no such edge,
and every part, being connected, keeps the constraints. What they ask of whole parts: ``enforcing.py``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.agglomeration.quotas import TooFewPartsError
from agglo_core.arrays import Mask
from agglo_core.errors import OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.registry.attribution import Member, attributed

__all__ = ["alone", "check_bounds", "constrained", "forbidden_by", "naming"]


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


def alone(graph: Graph, allowed: Graph) -> int:
    """Number of cells that have neighbours, and may be joined with none of them."""
    if allowed is graph:
        return 0
    return int(np.count_nonzero((np.diff(allowed.indptr) == 0) & (np.diff(graph.indptr) > 0)))


def check_bounds(graph: Graph, allowed: Graph, constraints: Sequence[Member], goals: Sequence[Goal]) -> None:
    """Raise OptionError if a goal is a smaller number of parts than a bound on parts needs.

    Measures are those of ``graph``, connections those that are ``allowed``.
    """
    asked = [member for member in constraints if hasattr(member.tool, "fewest")]
    least = min((goal.parts for goal in goals if isinstance(goal, CountGoal)), default=None)
    if not asked or least is None:
        return
    components = allowed.components()
    for member in asked:
        fewest = member.tool.fewest(graph, components)
        if least < fewest:
            raise OptionError(f"too few parts, {least}: {member.title} needs {fewest} at least")


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
        given = np.asarray(member.tool.forbidden(graph))
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
