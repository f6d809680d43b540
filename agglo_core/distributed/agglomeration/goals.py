"""Targets of a distributed run: levels possible with the given domains, and part counts per domain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal, SizeGoal, TooFewPartsError, apportion
from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.distributed.agglomeration.domain import Domain
from agglo_core.registry.attribution import Member

LEAST_PARTS = 16
"""Minimum mean number of parts per domain. Coarser levels use fewer domains, as parts end at borders.

Larger: better shapes on coarse levels, with fewer ranks at work (benchmarks/scale.py).
"""


class Census(NamedTuple):
    """Node counts, part counts and masses of all domains, one value per domain, equal on every rank."""

    nodes: Int
    alone: Int  # nodes without neighbours in any domain
    open: Int  # components with neighbours in other domains
    fewest: Int  # minimum number of parts, including isolated nodes
    mass: Float  # of nodes with neighbours
    estimates: Float  # (domains, goals): estimated parts of each size goal

    @property
    def domains(self) -> int:
        """Number of domains with at least one node."""
        return int(np.count_nonzero(self.nodes))

    @property
    def scattered(self) -> int:
        """Number of additional connected components that are only due to domain borders."""
        return int(np.maximum(self.open - 1, 0).sum())

    def expected(self, goal: Goal, place: int) -> float:
        """Return the number of parts to expect over all domains for a target with index ``place``."""
        return float(goal.parts) if isinstance(goal, CountGoal) else float(self.estimates[:, place].sum())


def row_of(domain: Domain, goals: Sequence[Goal], bounds: Sequence[Member]) -> list[float]:
    """Return the counts and masses of one domain: its row in the table of all domains."""
    graph = domain.graph
    if domain.n == 0:
        return [0.0] * (5 + len(goals))
    leading_out = np.zeros(graph.n, bool)
    leading_out[domain.links.node[~domain.links.barred]] = True
    alone = (np.diff(graph.indptr) == 0) & ~leading_out
    components = graph.components()
    fewest = int(components.max()) + 1
    for member in domain.counted(bounds):
        fewest = max(fewest, member.tool.fewest(graph, components))
    sizes = [float(goal.estimate(graph)) if isinstance(goal, SizeGoal) else 0.0 for goal in goals]
    return [
        domain.n,
        int(alone.sum()),
        len(np.unique(components[leading_out])),
        fewest,
        float(graph.mass[~alone].sum()),
        *sizes,
    ]


def census_of(rows: Sequence[Sequence[float]]) -> Census:
    """Build the census from the rows of all domains."""
    table = np.array(rows)
    nodes, alone, open_, fewest = (frozen_int(column) for column in table[:, :4].T)
    return Census(nodes, alone, open_, fewest, frozen_float(table[:, 4]), frozen_float(table[:, 5:]))


def ready_goals(goals: Sequence[Goal], census: Census) -> list[list[Goal]]:
    """Return the targets for each domain, finest first, that all given domains can meet.

    A single domain meets all goals. Counts are distributed by mass. Each domain gets at least the parts it
    needs, and at least as many as for a coarser goal.
    """
    count = len(census.nodes)
    # Drop coarse goals until the rest fits.
    number = len(goals)
    while number and count > 1 and not _fits(goals, number, census):
        number -= 1
    shares: list[list[Goal]] = []
    least = census.fewest
    # Distribute counts, coarsest first.
    for goal in reversed(goals[:number]):
        if isinstance(goal, CountGoal) and count > 1:
            least = _shares(goal.parts, census, least)
            shares.append([replace(goal, parts=int(share)) for share in least])
        else:
            shares.append([_raise_to_fewest(goal, int(fewest)) for fewest in census.fewest])
    return [list(each) for each in zip(*reversed(shares), strict=True)] if shares else [[]] * count


def _raise_to_fewest(goal: Goal, fewest: int) -> Goal:
    """Raise the part count of an inexact target to the minimum that a domain needs.

    Size targets and exact counts are returned unchanged.
    """
    if isinstance(goal, SizeGoal) or goal.exact:
        return goal
    return replace(goal, parts=max(goal.parts, fewest))


def _fits(goals: Sequence[Goal], number: int, census: Census) -> bool:
    """Return True if each domain can meet the finest ``number`` targets without being joined to others."""
    coarsest = goals[number - 1]
    expected = census.expected(coarsest, number - 1)
    if expected < max(LEAST_PARTS * census.domains, 2 * census.scattered):
        return False
    try:
        least = census.fewest
        for goal in reversed(goals[:number]):
            least = _shares(goal.parts, census, least) if isinstance(goal, CountGoal) else least
    except TooFewPartsError:
        return False
    return True


def _shares(parts: int, census: Census, least: Int) -> Int:
    """Return the part count per domain: one per isolated node, and the rest in proportion to mass."""
    alone, n_linked = census.alone, census.nodes - census.alone
    domains = np.flatnonzero(n_linked)
    shares = np.array(alone)
    if not len(domains):
        if parts < shares.sum():
            raise TooFewPartsError(parts, int(shares.sum()))
        return frozen_int(shares)
    minimum = np.minimum(np.maximum(least - alone, 1)[domains], n_linked[domains])
    shares[domains] += apportion(
        parts - int(alone.sum()), census.mass[domains], frozen_int(n_linked[domains]), frozen_int(minimum)
    )
    return frozen_int(shares)
