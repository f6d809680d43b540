"""Refiners that work on the parts of all blocks at once, as refiners of blocks."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.graph import Graph
from agglo_core.graph.objectives import numbered_parts
from agglo_core.protocols import Target


class _OfParts(Protocol):
    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int: ...


def refined_blocks(refiner: _OfParts, graph: Graph, labels: Int, target: Target) -> Int:
    """Labels ``(n,)``, numbered in each block, after ``refine_parts`` with the blocks of the graph."""
    parts = numbered_parts(graph, labels)
    k = int(parts.max(initial=-1)) + 1
    local, block = np.empty(k, np.int64), np.empty(k, np.int64)
    local[parts], block[parts] = labels, graph.block_ids
    return frozen_int(local[refiner.refine_parts(graph, parts, frozen_int(block), target)])
