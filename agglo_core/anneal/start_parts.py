"""What searches for parts start from and compare themselves with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agglo_core.anneal.part_changes import cut_in_two
from agglo_core.arrays import Int, frozen_int
from agglo_core.graph import Graph
from agglo_core.progress import to_nobody
from agglo_core.protocols import Target
from agglo_core.refine.connectivity import ConnectivityFixer
from agglo_core.refine.interface import InterfaceRefiner
from agglo_core.split.geometric import InertialBisection

_ROUNDING = 1e-9

Start = Callable[[Graph, int], Int]
"""Labels of a connected graph with about so many parts."""

Rival = Callable[[Graph, Target], Int]
"""Labels of a connected graph that meet a target."""


def connected_parts(graph: Graph, labels: Int) -> Int:
    """Labels without gaps, with every part connected."""
    return ConnectivityFixer().fix(graph, frozen_int(np.unique(labels, return_inverse=True)[1]))


def bisected_parts(graph: Graph, target: Target) -> Int:
    """Labels that inertial bisections, refined, find for a connected graph."""
    given, seeds = ([InterfaceRefiner()], ConnectivityFixer()), np.zeros(1, np.uint64)
    growth: Any = InertialBisection().grow(graph, frozen_int(np.zeros(graph.n)), *given)
    if target.h_star is None:
        return frozen_int(growth.split(frozen_int([target.parts or 1]), seeds, to_nobody)[0])
    return frozen_int(growth.split_to_size(target.h_star * (1 + _ROUNDING), seeds, to_nobody)[0])


def parts_within(graph: Graph, labels: Int, size: float) -> Int:
    """Labels once parts wider than a size are cut in two, and these again; cells are not."""
    while True:
        wide = (graph.part_diameters(labels) > size * (1 + _ROUNDING)) & (np.bincount(labels) > 1)
        if not wide.any():
            return labels
        labels = cut_in_two(graph, labels, wide)
