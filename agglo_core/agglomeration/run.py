"""The components at work on a run, and the checks of what each returns."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, UInt64, frozen_int
from agglo_core.errors import PluginError
from agglo_core.graph import Graph
from agglo_core.protocols import (
    Aiming,
    Bisector,
    ConnectivityFixer,
    LevelBisector,
    Partitioner,
    Refiner,
    Target,
)
from agglo_core.registry.discovery import PLUGIN_FAILURES

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "Crew",
    "Member",
    "Statistics",
    "Timed",
    "attributed",
    "bisect_by_block",
    "splitmix",
]

_MIX = tuple(np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


def splitmix(seeds: UInt64) -> UInt64:
    """The splitmix64 mixing step: well-spread seeds from any distinct ones."""
    z = seeds + _MIX[0]
    z = (z ^ (z >> np.uint64(30))) * _MIX[1]
    z = (z ^ (z >> np.uint64(27))) * _MIX[2]
    return np.asarray(z ^ (z >> np.uint64(31)))


@dataclass(slots=True)
class Timed:
    """Context that adds its CPU time to ``seconds[phase]``; a class, as generators cost more to enter."""

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
    """What happened during a run: counts, and CPU seconds by phase."""

    depth: int = 0
    bisections: int = 0
    repairs: int = 0
    fallbacks: int = 0
    oversized_cells: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def timed(self, phase: str) -> Timed:
        """Context that adds its CPU time to ``seconds[phase]``."""
        return Timed(self.seconds, phase)


@dataclass(frozen=True)
class Member:
    """A component object and how errors call it."""

    tool: Any
    title: str


@dataclass(frozen=True)
class Crew:
    """The components of one run, its seed and its record. Every output is checked here, at the border.

    ``fallback`` splits pieces that ``bisector`` left one-sided, if it declared one; ``finisher`` splits
    pieces when the bisector only knows direct k-way partitions.
    """

    bisector: Member
    refiners: Sequence[Member]
    post_refiners: Sequence[Member]
    fixer: Member
    finisher: Member
    fallback: Member | None = None
    watch: Callable[[dict[str, Any]], None] | None = None
    seed: int = 0
    statistics: Statistics = field(default_factory=Statistics)

    @cached_property
    def splitter(self) -> Member:
        """Who bisects: the bisector if it can, else the finisher."""
        return self.bisector if isinstance(self.bisector.tool, LevelBisector | Bisector) else self.finisher

    def aims(self, h_star: float) -> bool:
        """Whether the size of the parts makes a difference to the bisector."""
        return self.aimed(Target(h_star=h_star)) is not self

    def aimed(self, target: Target) -> Crew:
        """The crew with its bisector told the target; the crew itself if that makes no difference to it."""
        tool: Any = self.splitter.tool
        if not isinstance(tool, Aiming):
            return self
        with attributed(self.splitter):
            aimed = tool.aim(target)
        return self if aimed is tool else replace(self, bisector=replace(self.splitter, tool=aimed))

    def seeds(self, stage: int, count: int) -> UInt64:
        """Seeds ``(count,)`` of the pieces that stage (level, pass) number ``stage`` starts from."""
        root: UInt64 = np.full(count, stage, np.uint64) * _MIX[1]
        root += np.uint64(self.seed)
        place: UInt64 = np.arange(count, dtype=np.uint64)
        return splitmix(splitmix(root) + place)

    def bisect(self, level: Graph, seeds: UInt64) -> Int:
        """Sides ``(n,)`` in {0, 1}, both present in every block."""
        sides = _sides(self.splitter, level, seeds)
        lopsided = _one_sided(level, sides)
        if len(lopsided) and self.fallback is not None:
            self.statistics.fallbacks += len(lopsided)
            sides = sides.copy()
            nodes = np.flatnonzero(np.isin(level.block_ids, lopsided))
            sides[nodes] = _sides(self.fallback, level.take(lopsided), seeds[lopsided])
            lopsided = _one_sided(level, sides)
        if len(lopsided):
            size = int(level.sizes[lopsided[0]])
            rescue = f", and so did its fallback, {self.fallback.title}" if self.fallback else ""
            raise PluginError(f"{self.splitter.title} put all {size} cells of a piece on one side{rescue}")
        return sides

    def partition(self, graph: Graph, parts: int, seed: int) -> Int:
        """Labels ``(n,)`` of a direct partition of one connected block, gaps closed."""
        tool: Partitioner = self.bisector.tool
        with attributed(self.bisector):
            given = tool.partition(graph, Target(parts=parts), seed)
        labels = _integers(self.bisector, "partition", given, graph.n)
        if labels.min() < 0 or labels.max() >= parts:
            raise PluginError(
                f"{self.bisector.title} returned labels {labels.min()}..{labels.max()} for {parts} parts"
            )
        return frozen_int(np.unique(labels, return_inverse=True)[1])

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target, *, post: bool = False) -> Int:
        """Labels after all (post-)refiners, each keeping the label set of every block."""
        for member in self.post_refiners if post else self.refiners:
            tool: Refiner = member.tool
            with attributed(member):
                given = tool.refine(graph, frozen_int(labels), seeds, target)
            refined = _integers(member, "refine", given, graph.n)
            _same_parts(member, graph, labels, refined)
            labels = frozen_int(refined)
        return labels

    def fix(self, graph: Graph, labels: Int) -> Int:
        """Labels whose parts are all connected; only blocks in need of it are given to the fixer."""
        broken = broken_blocks(graph, labels)
        if len(broken) == 0:
            return labels
        self.statistics.repairs += len(broken)
        whole = len(broken) == graph.n_blocks
        piece = graph if whole else graph.take(broken)
        nodes = slice(None) if whole else np.flatnonzero(np.isin(graph.block_ids, broken))
        before = frozen_int(labels[nodes])
        tool: ConnectivityFixer = self.fixer.tool
        with attributed(self.fixer):
            given = tool.fix(piece, before)
        fixed = _integers(self.fixer, "fix", given, piece.n)
        _same_parts(self.fixer, piece, before, fixed)
        if len(broken_blocks(piece, fixed)):
            raise PluginError(f"{self.fixer.title} left a part disconnected")
        result = labels.copy()
        result[nodes] = fixed
        return frozen_int(result)


def bisect_by_block(bisector: Bisector, level: Graph, seeds: UInt64) -> NDArray[Any]:
    """Lift the simple road to a level: one call per block, each with its own generator."""
    sides = []
    for b in range(level.n_blocks):
        piece = level[b]
        given = np.asarray(bisector.bisect(piece, np.random.default_rng(int(seeds[b]))))
        if given.shape != (piece.n,):
            raise PluginError(f"bisect returned shape {given.shape} for a graph of {piece.n} nodes")
        sides.append(given)
    return np.concatenate(sides)


def broken_blocks(graph: Graph, labels: Int) -> Int:
    """Blocks with a part that is not connected."""
    from agglo_core.kernels import graphs

    found = graphs.broken_blocks(graph.offsets, graph.indptr, graph.indices, frozen_int(labels))
    return frozen_int(np.flatnonzero(found))


@contextmanager
def attributed(member: Member, *, spare: type[Exception] | tuple[()] = ()) -> Iterator[None]:
    """Turn whatever a component raises, but ``spare``, into a PluginError that names it."""
    try:
        yield
    except spare:
        raise
    except PluginError as error:
        raise PluginError(f"{member.title}: {error}") from error
    except PLUGIN_FAILURES as error:
        raise PluginError(f"{member.title} raised {type(error).__name__}: {error}") from error


def _sides(member: Member, level: Graph, seeds: UInt64) -> Int:
    """Sides as integers {0, 1}; probabilities are rounded (1 iff p >= 0.5)."""
    with attributed(member):
        if callable(getattr(member.tool, "bisect_level", None)):
            given = np.asarray(member.tool.bisect_level(level, seeds))
        else:
            given = bisect_by_block(member.tool, level, seeds)
    if given.shape != (level.n,):
        raise PluginError(f"{member.title} returned shape {given.shape}, expected ({level.n},)")
    if given.dtype.kind == "f":
        if not ((given >= 0) & (given <= 1)).all():
            raise PluginError(f"{member.title} returned probabilities that are NaN or outside [0, 1]")
        return frozen_int(given >= 0.5)
    if given.dtype.kind not in "iub":
        raise PluginError(f"{member.title} returned {given.dtype}, expected integers, booleans or floats")
    if given.min() < 0 or given.max() > 1:
        raise PluginError(f"{member.title} returned sides {given.min()}..{given.max()}, expected 0 and 1")
    return frozen_int(given)


def _one_sided(level: Graph, sides: Int) -> Int:
    ones = np.add.reduceat(sides, level.offsets[:-1])
    return frozen_int(((ones == 0) | (ones == level.sizes)).nonzero()[0])


def _integers(member: Member, what: str, given: Any, n: int) -> Int:
    labels = np.asarray(given)
    if labels.shape != (n,) or labels.dtype.kind not in "iub":
        raise PluginError(
            f"{member.title}: {what} returned shape {labels.shape} of {labels.dtype}, "
            f"expected ({n},) integers"
        )
    return frozen_int(labels)


def _same_parts(member: Member, graph: Graph, before: Int, after: Int) -> None:
    """Raise unless each block has the labels it had."""
    stride = int(before.max()) + 1
    if after.min() < 0 or after.max() >= stride:
        raise PluginError(
            f"{member.title} created labels {after.min()}..{after.max()} beyond 0..{stride - 1}"
        )
    if stride == 2 and not len(_one_sided(graph, before)) and not len(_one_sided(graph, after)):
        return  # nearly always, and at a fraction of what follows
    had, has = _present(graph, before, stride), _present(graph, after, stride)
    if (had != has).any():
        block, part = np.argwhere(had != has)[0]
        verb = "emptied" if had[block, part] else "created"
        raise PluginError(f"{member.title} {verb} part {part} of block {block}")


def _present(graph: Graph, labels: Int, stride: int) -> NDArray[np.bool_]:
    """Which labels 0..stride−1 occur in each block ``(B, stride)``."""
    room = graph.n_blocks * stride
    return (np.bincount(graph.block_ids * stride + labels, minlength=room) > 0).reshape(-1, stride)
