"""One agglomeration run: its components, seed and statistics."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from agglo_core.agglomeration.border import (
    bisector_for,
    broken_blocks,
    broken_halves,
    check_labels,
    check_moves,
    check_parts,
    check_widths,
    one_sided_blocks,
    request_sides,
    require_no_worse,
    sides_by_share,
)
from agglo_core.arrays import Float, Int, Mask, UInt64, frozen_int, splitmix
from agglo_core.errors import PluginError
from agglo_core.graph import Graph
from agglo_core.progress import Listener, labelled, noted_limits
from agglo_core.protocols import Target
from agglo_core.registry.attribution import Member, attributed
from agglo_core.split.side_shares import shift_cuts

_APART = np.uint64(0xBF58476D1CE4E5B9)  # increment between the seed roots of two stages


@dataclass(slots=True)
class Timed:
    """Context manager that adds the CPU time spent in it to ``seconds[phase]``.

    A class, because generator contexts are slower to enter.
    """

    seconds: dict[str, float]
    phase: str
    start: float = 0.0

    def __enter__(self) -> None:
        self.start = time.process_time()

    def __exit__(self, *_: object) -> None:
        spent = time.process_time() - self.start
        self.seconds[self.phase] = self.seconds.get(self.phase, 0.0) + spent


@dataclass
class Statistics:
    """Statistics of a run: counts, and CPU seconds by phase.

    ``time_limits`` counts the searches that a time limit ended, ``curve_levels`` the levels that started as
    runs of a space-filling curve.
    """

    depth: int = 0
    bisections: int = 0
    repairs: int = 0
    fallbacks: int = 0
    oversized_cells: int = 0
    split_parts: int = 0
    small_parts: int = 0
    time_limits: int = 0
    curve_levels: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def timed(self, phase: str) -> Timed:
        """Return a context manager that adds the CPU time spent in it to ``seconds[phase]``."""
        return Timed(self.seconds, phase)

    def as_dict(self) -> dict[str, Any]:
        """Return a copy of all values as a dictionary, ten times as fast as :func:`dataclasses.asdict`."""
        return vars(self) | {"seconds": dict(self.seconds)}

    @contextmanager
    def limited(self) -> Iterator[None]:
        """Context manager that counts the searches ended by a time limit."""
        with noted_limits() as noted:
            yield
        self.time_limits += len(noted)


@dataclass(frozen=True)
class Run:
    """One agglomeration run: its components, seed and statistics.

    Every component output is checked.

    Attributes
    ----------
    bisector : Member
        Splits pieces in two.
    refiners, post_refiners : sequence of Member
        Applied in this order after each split, and to each finished level.
    fixer : Member
    fallback : Member, optional
        Splits the pieces that ``bisector`` leaves on one side.
    partitioner : Member, optional
        Makes direct k-way partitions.
    listen : callable, optional
        Called after each recursion depth with the run's progress, for plugins.
    seed : int
    statistics : Statistics
    progress : callable, optional
        Called with an :class:`~agglo_core.progress.Progress` in each phase, for the caller.

    Examples
    --------
    >>> from agglo_core.authoring import ConnectivityFixer, InertialBisection, Target
    >>> from agglo_core.registry.attribution import Member
    >>> from agglo_core.agglomeration.run import Run
    >>> bisector, fixer = Member(InertialBisection(), "mine"), Member(ConnectivityFixer(), "fixer")
    >>> run = Run(bisector, refiners=[], post_refiners=[], fixer=fixer)
    >>> run.halve(agglo.samples.strip(4).graph, run.seeds(0, 1), Target(parts=2))
    array([0, 0, 1, 1])
    """

    bisector: Member
    refiners: Sequence[Member]
    post_refiners: Sequence[Member]
    fixer: Member
    fallback: Member | None = None
    partitioner: Member | None = None
    listen: Callable[[dict[str, Any]], None] | None = None
    seed: int = 0
    statistics: Statistics = field(default_factory=Statistics)
    progress: Listener | None = None

    def on_level(self, place: int, count: int) -> Run:
        """Return the run with its progress messages labelled as coarse level ``place`` of ``count``."""
        if self.progress is None or count == 1:
            return self
        return replace(self, progress=labelled(self.progress, f"level {place + 1} of {count}"))

    def for_target(self, target: Target) -> Run:
        """Return the run with its bisector adapted to this target, or the run itself if nothing changes."""
        bisector = bisector_for(self.bisector, target)
        return self if bisector is self.bisector else replace(self, bisector=bisector)

    def seeds(self, stage: int, count: int) -> UInt64:
        """Return random seeds ``(count,)`` for the initial pieces of a stage, such as a coarse level."""
        root: UInt64 = np.full(count, stage, np.uint64) * _APART
        root += np.uint64(self.seed)
        place: UInt64 = np.arange(count, dtype=np.uint64)
        return splitmix(splitmix(root) + place)

    def bisect(self, level: Graph, seeds: UInt64, shares: Float | None = None) -> Int:
        """Bisect all blocks into non-empty sides ``(n,)``.

        ``shares (B,)`` are the mass fractions for a side in each block, by default 1/2.
        """
        # 1. Call the bisector, with shares if it supports them.
        sides, uneven = sides_by_share(self.bisector, level, seeds, shares)
        one_sided = one_sided_blocks(level, sides)
        # 2. Let the fallback split the blocks with an empty side.
        if len(one_sided) and self.fallback is not None:
            self.statistics.fallbacks += len(one_sided)
            sides, nodes = sides.copy(), np.isin(level.block_ids, one_sided)
            sides[nodes] = request_sides(self.fallback, level.take(one_sided), seeds[one_sided])
            one_sided = one_sided_blocks(level, sides)
        if len(one_sided):
            size = level.sizes[one_sided[0]]
            also = f", and so did its fallback, {self.fallback.title}" if self.fallback else ""
            raise PluginError(f"{self.bisector.title} put all {size} cells of a piece on one side{also}")
        # 3. Move the cut of the remaining uneven blocks to their share.
        return shift_cuts(level, sides, uneven, shares)

    def note_widths(self, labels: Int, wide: Mask, limit: float) -> None:
        """Record the number of parts marked in ``wide (k,)``, and check that they are single cells."""
        alone = check_widths(self.bisector, labels, wide, limit)
        self.statistics.oversized_cells = max(alone, self.statistics.oversized_cells)

    def count_depths(self, depths: Int) -> None:
        """Add the counts ``(depths, 3)`` of split pieces, cells and repairs to the statistics."""
        for blocks, cells, mended in depths.tolist():
            self.statistics.depth += 1
            self.statistics.bisections += blocks
            self.statistics.repairs += mended
            if self.listen is not None:
                self.listen({"depth": self.statistics.depth, "pieces": 2 * blocks, "cells": cells})

    @property
    def final_parts(self) -> bool:
        """True if a direct partition is neither refined nor polished."""
        return self.partitioner is not None and bool(getattr(self.partitioner.tool, "final_parts", False))

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Partition a connected block directly, and return labels ``(n,)`` without gaps.

        With a size, the target's part count is an estimate, and the partition may have more parts.
        """
        member = self.partitioner
        if member is None:
            raise PluginError(f"{self.bisector.title} has no k-way partition")
        with attributed(member.title), self.statistics.limited():
            given = member.tool.partition(graph, target, seed)
        most = graph.n if target.parts is None or target.h_star is not None else target.parts
        return check_parts(member, given, graph.n, most)

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target, *, post: bool = False) -> Int:
        """Apply all (post-)refiners in turn, and check that each keeps the parts of every block."""
        for member in self.post_refiners if post else self.refiners:
            with attributed(member.title), self.statistics.limited():
                given = member.tool.refine(graph, frozen_int(labels), seeds, target)
            refined = check_labels(member, "refine", graph, labels, given)
            require_no_worse(member, graph, labels, refined)
            labels = refined
        return labels

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Apply all post-refiners to the whole graph, where part p stays in block ``block[p]``."""
        for member in self.post_refiners:
            with attributed(member.title), self.statistics.limited():
                given = member.tool.refine_parts(graph, labels, block, target)
            labels = check_moves(member, block, labels, given)
        return labels

    def halve(self, level: Graph, seeds: UInt64, target: Target, shares: Float | None = None) -> Int:
        """Bisect, refine and fix all blocks, and return the connected sides."""
        statistics = self.statistics
        with statistics.timed("bisect"):
            sides = self.bisect(level, seeds, shares)
        with statistics.timed("refine"):
            sides = self.refine(level, sides, seeds, target)
        with statistics.timed("fix"):
            sides = self.fix(level, sides, halves=True)
        self.count_depths(np.array([[level.n_blocks, level.n, 0]]))
        return sides

    def fix(self, graph: Graph, labels: Int, *, halves: bool = False) -> Int:
        """Connect all parts with the fixer.

        The fixer receives only the broken blocks. With ``halves`` the blocks must be connected and the labels
        0 and 1, so that a faster test applies.
        """
        # 1. Find the blocks with a disconnected part.
        broken = (broken_halves if halves else broken_blocks)(graph, labels)
        if len(broken) == 0:
            return labels
        self.statistics.repairs += len(broken)
        # 2. Pass these blocks to the fixer, and check its result.
        whole = len(broken) == graph.n_blocks
        piece = graph if whole else graph.take(broken)
        nodes = slice(None) if whole else np.flatnonzero(np.isin(graph.block_ids, broken))
        before = frozen_int(labels[nodes])
        with attributed(self.fixer.title):
            given = self.fixer.tool.fix(piece, before)
        fixed = check_labels(self.fixer, "fix", piece, before, given)
        if len(broken_blocks(piece, fixed)):
            raise PluginError(f"{self.fixer.title} left a part disconnected")
        # 3. Copy the fixed labels back.
        result = labels.copy()
        result[nodes] = fixed
        return frozen_int(result)
