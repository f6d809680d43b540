"""Constraints of a distributed run, evaluated on a rank's cells and ghosts, and agreed between ranks.

Constraints that forbid edges are always supported. Of constraints on whole parts, only bounds and barriers
are supported, because they extend to agglomerates. Others are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.agglomeration import Pipeline
from agglo_core.agglomeration.keywords import BOUNDS, RULES
from agglo_core.agglomeration.rules.edges import forbidden_by
from agglo_core.agglomeration.rules.members import Rules
from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.constraints.barriers import Barriers
from agglo_core.constraints.bounds import Bounds
from agglo_core.distributed.agglomeration.cells import Cells, agree_on_forbidden
from agglo_core.distributed.communication import Ranks
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.registry import Registry
from agglo_core.registry.attribution import Member

_OF_PARTS = ("admissible", "incomplete")


@dataclass(frozen=True, eq=False)
class Kept:
    """Constraints of a run by local indices of cells and edges, ghosts included.

    Attributes
    ----------
    forbidden : (m,) bool
        Graph entries that no part may cross.
    barriers : (p, 2) int
        Cell pairs that no part may contain.
    bounds : sequence of Member
        Bounds on part sizes.
    weights : (n, len(bounds)) float
        Cell weights, a column per bound.
    members : sequence of Member
        All constraints, for messages.
    """

    forbidden: Mask
    barriers: Int
    bounds: Sequence[Member]
    weights: Float
    members: Sequence[Member]


def evaluate_rules(cells: Cells, pipeline: Pipeline, mesh: Mesh, registry: Registry) -> Kept:
    """Evaluate the constraints of a run on a rank's cells and ghosts, consistently on all ranks.

    A rule without effect on some ranks, such as a patch that lies elsewhere, still applies to the others.

    Raises
    ------
    OptionError
        If a rule fits on no rank, or constrains whole parts by other means than bounds and barriers.
    """
    ranks, graph = cells.ranks, mesh.graph
    with ranks.together():
        pipeline.cell_weights(graph)  # may raise on a single rank
    # Evaluate each rule on all ranks.
    members_per_rule = (
        _collect_members(ranks, rule, mesh, graph, registry) for rule in _single_rules(pipeline)
    )
    members = [member for found in members_per_rule for member in found]
    forbidden, pairs, bounds = np.zeros(len(graph.indices), bool), [], []
    # Collect barriers, bounds and forbidden edges.
    with ranks.together():
        for member in members:
            if isinstance(member.tool, Bounds):
                bounds.append(member)
                continue
            if isinstance(member.tool, Barriers):
                pairs.append(member.tool.pairs)
            elif any(callable(getattr(member.tool, name, None)) for name in _OF_PARTS):
                raise OptionError(
                    f"{member.title} applies to whole parts; across ranks only bounds and "
                    "barriers are supported"
                )
            forbidden |= forbidden_by(member, graph)
    with ranks.together():
        weights = np.empty((graph.n, len(bounds)))
        for column, member in enumerate(bounds):
            weights[:, column] = member.tool.weights(graph)
    barriers = np.concatenate([np.empty((0, 2), np.int64), *pairs])
    return Kept(
        agree_on_forbidden(cells, forbidden), frozen_int(barriers), bounds, frozen_float(weights), members
    )


def _single_rules(pipeline: Pipeline) -> Iterator[Rules]:
    """Yield the constraints of the run, such that an error in one does not affect the others."""
    for each in pipeline.constraints:
        yield Rules(constraints=(each,))
    for name in ("regions", "barriers", "where", "boundary_rules"):
        if getattr(pipeline, name) is not None:
            yield replace(Rules(), **{name: getattr(pipeline, name)})
    bounds = {name: getattr(pipeline, name) for name in BOUNDS}
    if any(value is not None for value in bounds.values()):
        yield replace(Rules(), **bounds, weights=pipeline.weights)


def _collect_members(ranks: Ranks, rule: Rules, mesh: Mesh, graph: Graph, registry: Registry) -> list[Member]:
    """Build the constraints of a rule on this rank.

    An error is raised only if the rule applies on no rank.
    """
    refusal: OptionError | None = None
    members: list[Member] = []
    with ranks.together():
        try:
            members = rule.members(mesh, graph, registry)
        except OptionError as error:
            refusal = error
    if all(ranks.gathered(refusal is not None)):
        message = ranks.from_first(str(refusal))
        raise OptionError(message)
    return members


def with_ghosts(pipeline: Pipeline, exchange: Callable[[NDArray[Any]], NDArray[Any]], n_own: int) -> Pipeline:
    """Return the run description with arrays on a rank's cells extended to its ghosts."""
    changed: dict[str, Any] = {}
    for name in RULES:
        value = getattr(pipeline, name)
        of_cells = isinstance(value, np.ndarray) and value.shape[:1] == (n_own,) and name != "barriers"
        if of_cells and not (name == "metric" and value.ndim == 2):
            changed[name] = exchange(value)
    return replace(pipeline, **changed)
