"""Runs of the curve along which the cells are numbered, as the start of levels by part counts."""

from __future__ import annotations

from typing import TypeGuard

import numpy as np

from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Float, Index, Int, frozen_float, frozen_int
from agglo_core.graph import Graph
from agglo_core.progress import phase
from agglo_core.registry.attribution import attributed
from agglo_core.threads import over_ranges

_ACROSS = 6
"""Fewest parts along each axis of a block. With fewer, the polished runs are less round than polished
bisections (benchmarks/curve.py)."""
_CELLS = (7, 128)
"""Smallest and largest mean number of cells per part. The polish cannot make runs of fewer cells round, as
each move changes much, nor runs of more cells, as it moves few layers (benchmarks/curve.py)."""
_SAMPLE = 5000
"""Approximate number of cells examined on large meshes, for the next constant."""
_STRETCHED = 1e-3
"""Largest fraction of stretched cells. The polish leaves runs through stretched cells long
(benchmarks/curve.py)."""


def replaces_bisections(run: Run, post: PostPass) -> bool:
    """Return True if the bisector allows levels of this run to start from runs of the curve."""
    if not post.polish or not run.bisector.offers("allows_curve"):
        return False
    tools = [[member.tool for member in members] for members in (run.refiners, run.post_refiners)]
    with attributed(run.bisector.title):
        return bool(run.bisector.tool.allows_curve(tools[0], run.fixer.tool, tools[1]))


def level_quotas(graph: Graph, blocks: Int, goal: CountGoal) -> Int:
    """Return the number of parts for each of the connected ``blocks (n,)``."""
    if not blocks.any():  # one block, the usual case: a connected mesh
        return goal.shares(frozen_float([graph.mass.sum()]), frozen_int([graph.n]))
    return goal.shares(frozen_float(np.bincount(blocks, graph.mass)), frozen_int(np.bincount(blocks)))


def suits_curve(goal: Goal, graph: Graph, blocks: Int) -> TypeGuard[CountGoal]:
    """Return True if polished runs of the curve are about as round as polished bisections of the ``blocks``.

    This needs many parts, with several cells each, and few stretched cells.
    """
    from agglo_core.agglomeration.levels.curve_kernels import stretched_cells

    if not isinstance(goal, CountGoal) or goal.quotas is not None:
        return False
    fewest = _ACROSS**graph.dim * (int(blocks.max(initial=-1)) + 1)
    if goal.parts < fewest or not _CELLS[0] <= graph.n / goal.parts <= _CELLS[1]:
        return False
    step = graph.n // _SAMPLE | 1  # odd, so that structured meshes are sampled evenly
    stretched = stretched_cells(graph.indptr, graph.indices, graph.centroids, graph.measures, step)
    return bool(stretched * step <= _STRETCHED * graph.n)


def cut_curve(graph: Graph, blocks: Int, goal: CountGoal, run: Run) -> Int:
    """Divide each block into connected runs of about equal mass, and return the labels ``(n,)``."""
    from agglo_core.compiled.graphs import list_blocks

    with run.statistics.timed("runs"), phase(run.progress, "cutting the curve"):
        quotas = level_quotas(graph, blocks, goal)
        cells, offsets = list_blocks(blocks, frozen_int(np.arange(len(quotas))), len(quotas))
        labels = connected_runs(graph, graph.mass, cells, offsets, quotas)
    if labels.min(initial=0) < 0:
        raise AssertionError("a block is disconnected")
    run.statistics.curve_levels += 1
    return labels


def connected_runs(graph: Graph, mass: Float, cells: Index, offsets: Int, quotas: Int) -> Int:
    """Divide each connected block into connected parts along the curve, and return the labels ``(n,)``.

    Block b consists of ``cells[offsets[b]:offsets[b + 1]]``, in the order of the curve and of increasing
    numbers. Its ``quotas[b]`` parts start as runs of about equal ``mass (n,)``. Each keeps its largest
    component, and the other cells join an adjacent part.
    """
    from agglo_core.agglomeration.levels.curve_kernels import cut_runs, join_strays, list_strays

    parts, starts = cut_runs(mass, cells, offsets, quotas)
    open_parts = parts.copy()

    def strays_of(start: int, stop: int) -> Index:
        found: Index = list_strays(
            graph.indptr, graph.indices, cells, starts[start : stop + 1], parts, open_parts
        )
        return found

    strays = over_ranges(strays_of, len(starts) - 1, shares=1, work=graph.n)
    owner = np.repeat(np.arange(len(quotas)), quotas)
    join_strays(graph.indptr, graph.indices, graph.interface, parts, np.concatenate(strays), owner)
    return frozen_int(parts)
