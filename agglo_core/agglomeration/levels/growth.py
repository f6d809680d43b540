"""Growth: the bisector performs all recursive splits of a level in one call.

A bisector with a method ``grow`` splits pieces recursively, including refinement and fixing. The driver then
checks the result once per level instead of once per depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, cast, runtime_checkable

from agglo_core.agglomeration.border import check_split, check_split_to_size
from agglo_core.agglomeration.goals import CountGoal, Goal, SizeGoal
from agglo_core.agglomeration.levels.curve import cut_curve, level_quotas, replaces_bisections, suits_curve
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, UInt64
from agglo_core.errors import PluginError
from agglo_core.graph import Graph
from agglo_core.progress import Notify, phase
from agglo_core.registry.attribution import attributed


class Growth(Protocol):
    """Recursive bisection of graph pieces, performed by the bisector in one call per level."""

    def split(self, quotas: Int, seeds: UInt64, notify: Notify) -> tuple[Int, Int]:
        """Split piece i, with the seed ``seeds[i]``, into ``quotas[i]`` connected pieces.

        Returns the new labels ``(n,)``, numbered by first node: these are the pieces for the next call. Also
        returns, for each depth, the counts ``(depths, 3)`` of split pieces, their cells and repaired pieces.
        The callable ``notify`` receives the completed work share and a text.
        """


@runtime_checkable
class GrowthToSize(Growth, Protocol):
    """Optional interface of a growth object: bisect until all parts are small enough."""

    def split_to_size(self, limit: float, seeds: UInt64, notify: Notify) -> tuple[Int, Int]:
        """Split the pieces until only single cells are wider than ``limit``.

        The results are those of ``split``.
        """


@runtime_checkable
class CurveStart(Protocol):
    """Optional interface of a bisector: allow levels to start from runs of a space-filling curve."""

    def allows_curve(self, refiners: Sequence[Any], fixer: Any, post_refiners: Sequence[Any]) -> bool:
        """Return True if polished runs may replace polished bisections with these components."""


@runtime_checkable
class Growing(Protocol):
    """Optional interface of a bisector: make, refine and fix all splits itself."""

    def grow(self, graph: Graph, pieces: Int, refiners: Sequence[Any], fixer: Any) -> Growth | None:
        """Return a growth object for the connected ``pieces (n,)``, or None if components are unsupported.

        The parts must be as good as the joint result of ``bisect_level``, the refiners and the fixer. A
        bisector that cannot replace these components returns None.
        """


def grow_levels(graph: Graph, goals: Sequence[Goal], run: Run, post: PostPass) -> list[Int] | None:
    """Compute all levels with one bisector call each, finest first, or return None if this is unsupported.

    The result is None if the bisector has no method ``grow``, declines the run's components, depends on the
    target, or does not support a goal. The coarsest level comes first in the computation. Each level's parts
    are the initial pieces for the next level. Runs of the curve replace calls where they are as good.
    """
    # 1. Growth serves only bisectors that do not depend on the target.
    if any(run.for_target(goal.target) is not run for goal in goals):
        return None
    labels, on_curve = graph.components(), replaces_bisections(run, post)
    growth: Growth | None = None
    result: list[Int] = []
    for stage, goal in enumerate(reversed(goals)):
        level_run = run.on_level(stage, len(goals))
        # 2. Cut the curve into runs where this is as good.
        if on_curve and suits_curve(goal, graph, labels):
            parts, tested = cut_curve(graph, labels, goal, level_run), True
        # 3. Otherwise split the pieces.
        else:
            if growth is None:
                growth = _request_growth(graph, labels, level_run)
            if growth is None or not all(_serves(growth, each) for each in goals):
                if stage == 0:
                    return None
                raise PluginError(f"{run.bisector.title} grew one level of the run, but declined the next")
            parts = _split(graph, labels, goal, growth, level_run, stage, tested=not post.polish)
            tested = not post.polish
        if post.active:
            growth = None  # free its arrays before the post-passes, which change the pieces
        labels = post.apply(graph, labels, parts, goal, level_run, stage, tested=tested)
        result.append(labels)
    return result[::-1]


def _request_growth(graph: Graph, pieces: Int, run: Run) -> Growth | None:
    """Request from the bisector a growth object that starts from the connected ``pieces (n,)``.

    The result is None if the bisector has no method ``grow`` or declines the run's refiners and fixer.
    """
    if not run.bisector.offers("grow"):
        return None
    tool, refiners = run.bisector.tool, [member.tool for member in run.refiners]
    with attributed(run.bisector.title):
        made: Growth | None = tool.grow(graph, pieces, refiners, run.fixer.tool)
    return made


def _serves(growth: Growth, goal: Goal) -> bool:
    if isinstance(goal, SizeGoal):
        return callable(getattr(growth, "split_to_size", None))
    return goal.quotas is None


def _split(
    graph: Graph, labels: Int, goal: Goal, growth: Growth, run: Run, stage: int, *, tested: bool
) -> Int:
    """Split the initial pieces of a level into its parts, and return the part labels ``(n,)``.

    If ``tested`` is False, connectivity and widths are not checked here, because the polish checks them.
    """
    seeds, owner = run.seeds(stage, int(labels.max()) + 1), run.bisector
    with run.statistics.timed("grow"), phase(run.progress, "agglomerating") as notify:
        # Counts: each piece has a quota. Sizes: split to the size, and record single cells that are wider.
        if isinstance(goal, CountGoal):
            quotas = level_quotas(graph, labels, goal)
            with attributed(owner.title):
                raw_labels, depths = growth.split(quotas, seeds, notify)
            parts = check_split(owner, graph, labels, quotas, raw_labels, tested=tested)
        else:
            to_size = cast(GrowthToSize, growth)  # ``_serves`` has checked it
            with attributed(owner.title):
                raw_labels, depths = to_size.split_to_size(goal.limit, seeds, notify)
            parts = check_split_to_size(owner, graph, labels, raw_labels, tested=tested)
            if tested:
                run.note_widths(parts, graph.wide_parts(parts, goal.limit), goal.limit)
        run.count_depths(depths)
    return parts
