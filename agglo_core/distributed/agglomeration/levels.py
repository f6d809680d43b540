"""Levels of a distributed run: agglomerate, coarsen, join domains, and repeat."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from agglo_core.agglomeration.goals import CountGoal, Goal, SizeGoal
from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.agglomeration.domain import Domain
from agglo_core.distributed.agglomeration.domain_run import DomainRun
from agglo_core.distributed.agglomeration.goals import Census, census_of, ready_goals, row_of
from agglo_core.distributed.agglomeration.stages import Numbering, Stage
from agglo_core.distributed.communication import Traffic
from agglo_core.progress import Notify

_NODES_PER_PART = 32
"""Minimum number of nodes per part of larger domains. Fewer nodes degrade shapes.
Benchmark: benchmarks/constants.py."""

_CELLS_PER_NODE = 16
"""Maximum number of nodes per intermediate agglomerate. Larger: less to send, but worse shapes.
Benchmark: benchmarks/constants.py."""

_FEWEST_CELLS = 4
"""Minimum number of nodes per intermediate agglomerate. Below, an intermediate level does not pay.
Benchmark: benchmarks/constants.py."""

_SIZES_PER_PART = 4.0
"""Intermediate agglomerates that fit in a row into a part at the target size. Larger: more to send, with
shapes that hardly differ. Benchmark: benchmarks/constants.py."""

_FEW_NODES = 4096
"""Number of nodes per domain up to which nodes are sent without intermediate agglomeration.

Larger: better shapes, but more to send.
Benchmark: benchmarks/constants.py.
"""


@dataclass(frozen=True)
class Level:
    """One level of a distributed run: global part id of each node, numbering, and messages sent."""

    ids: Mapping[int, Int]
    numbering: Numbering
    sent: Traffic

    def with_ids(self, ids: Mapping[int, Int], sent: Traffic | None = None) -> Level:
        """Return the level with part ids on other nodes, and with the messages ``sent`` for them added."""
        return replace(self, ids=ids, sent=self.sent + (sent or Traffic()))


def build_levels(
    stage: Stage, goals: Sequence[Goal], maker: DomainRun, turn: int = 0, notify: Notify | None = None
) -> list[Level]:
    """Build a level for each target, finest first.

    Goals with enough parts for the given domains are built first, all at once. The others are built from the
    resulting agglomerates on half as many domains. Without any feasible goal, intermediate agglomerates are
    built.
    """
    if not goals:
        return []
    if notify is not None:
        notify(0.0, f"{len(goals)} levels, {stage.count} domains")
    # Case 1: some goals are feasible on the given domains.
    census = census_of(stage.of_all(lambda domain: row_of(domain, goals, maker.kept.bounds)))
    shares = ready_goals(goals, census)
    if shares[0]:
        return _build_feasible_levels(stage, goals, shares, maker, turn, notify)
    # Case 2: shrink the domains by an intermediate level first.
    middle_goal = _middle_goal(census, goals[0])
    if middle_goal is not None:
        return _build_by_middle_level(stage, middle_goal, goals, maker, turn, notify)
    # Case 3: join pairs of domains, and bring the levels back.
    fewer, way = stage.halved()
    levels = build_levels(fewer, goals, maker, turn + 1, notify)
    numbers = sorted(stage.domains)
    stage_levels = []
    for level in levels:
        ids = dict(zip(numbers, way.brought(level.ids), strict=True))
        stage_levels.append(level.with_ids(ids, stage.ranks.since_last()))
    return stage_levels


def _build_feasible_levels(
    stage: Stage,
    goals: Sequence[Goal],
    shares: Sequence[Sequence[Goal]],
    maker: DomainRun,
    turn: int,
    notify: Notify | None,
) -> list[Level]:
    """Build the levels that are possible on the given domains, then the coarser levels on top of them."""
    with stage.ranks.together():
        labels = {
            number: maker.levels(domain, shares[number], number, turn)
            for number, domain in stage.domains.items()
        }
    levels = []
    for place in range(len(shares[0])):
        level_labels = {number: values[place] for number, values in labels.items()}
        numbering = stage.numbered(level_labels)
        ids = {n: frozen_int(numbering.first[n] + values) for n, values in level_labels.items()}
        levels.append(Level(ids, numbering, stage.ranks.since_last()))
    coarser_goals = goals[len(levels) :]
    if not coarser_goals:
        return levels
    return levels + _build_above(stage, level_labels, numbering, coarser_goals, maker, turn, notify)


def _build_by_middle_level(
    stage: Stage,
    middle_goal: Goal,
    goals: Sequence[Goal],
    maker: DomainRun,
    turn: int,
    notify: Notify | None,
) -> list[Level]:
    """Agglomerate to an auxiliary level first, and build the levels from its agglomerates."""
    total = sum(int(nodes) for (nodes,) in stage.of_all(lambda domain: [domain.n]))
    with stage.ranks.together():
        labels = {
            number: maker.intermediate(domain, _share(domain, middle_goal, total), number, turn)
            for number, domain in stage.domains.items()
        }
    return _build_above(stage, labels, stage.numbered(labels), goals, maker, turn, notify)


def _build_above(
    stage: Stage,
    labels: Mapping[int, Int],
    numbering: Numbering,
    goals: Sequence[Goal],
    maker: DomainRun,
    turn: int,
    notify: Notify | None,
) -> list[Level]:
    """Build the coarser levels from the agglomerates ``labels``, and return their part ids on finer nodes."""
    coarse = stage.coarsened(labels, numbering)
    levels = build_levels(coarse, goals, maker, turn + 1, notify)
    return [
        level.with_ids({number: frozen_int(level.ids[number][labels[number]]) for number in labels})
        for level in levels
    ]


def _middle_goal(census: Census, goal: Goal) -> Goal | None:
    """Return the target of an auxiliary level that shrinks the domains before they are joined.

    None if there are too few nodes, in total or per part, for an auxiliary level to pay off.
    """
    total = int(census.nodes.sum())
    expected = max(census.expected(goal, 0), 1.0)
    nodes = min(_CELLS_PER_NODE, int(total / (_NODES_PER_PART * expected)))
    if total <= _FEW_NODES * census.domains or nodes < _FEWEST_CELLS:
        return None
    if isinstance(goal, SizeGoal):  # an upper bound of agglomerate sizes
        return SizeGoal(goal.h_star / _SIZES_PER_PART)
    return CountGoal(total // nodes)


def _share(domain: Domain, goal: Goal, total: int) -> Goal:
    """Return the target for one domain: a size unchanged, a count in proportion to its nodes."""
    if domain.n == 0 or isinstance(goal, SizeGoal):
        return goal
    return CountGoal(max(1, round(goal.parts * domain.n / total)), exact=False)
