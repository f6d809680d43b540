"""Objective ``solver``, a number F: moment of inertia plus interface of the parts, both normalised.

F is the parts' moment of inertia plus 0.2 times their interface, each relative to equally many regular
hexagons with the same measure. In 3-D, truncated octahedra (Kelvin cells) replace hexagons. F has no unit and
hardly depends on the part count.
"""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.graph.dual import Graph
from agglo_core.graph.functionals import part_cuts
from agglo_core.graph.moves import mass_centres, part_sums

INTERFACE_WEIGHT = 0.2
"""Weight of the interface relative to the inertia.

Larger: better conditioned, but less accurate (benchmarks/solver_shapes.py). The measurements are reported in
docs/reference/annealing.md.
"""

_HEXAGON = {2: (5.0 / (18.0 * 3.0**0.5), (2.0 * 3.0**0.5) ** 0.5), 3: (0.2356299, 2.6573970)}
"""Moment of inertia about the centre, and half the surface, of such a cell with measure 1, by dimension."""


def solver_factors(graph: Graph, counts: Int) -> tuple[Float, Float]:
    """Return the coefficients of inertia and interface in F, per block ``(B,)`` with ``counts`` parts.

    Without measures or weights, inertia does not count, and the interface is relative to that of all cells.
    """
    blocks, inertia, half_surface = graph.block_ids, *_HEXAGON[graph.dim]
    measure, weight = part_sums(blocks, graph.measures), part_sums(blocks, graph.weights)
    some = (measure > 0.0) & (weight > 0.0)
    unit = np.where(some, measure, 1.0) / counts  # measure of a hexagon
    whole = np.where(weight > 0.0, weight, 1.0) * unit ** (2.0 / graph.dim)
    rows = np.repeat(blocks, np.diff(graph.indptr))
    edges = 0.5 * np.bincount(rows, graph.interface, len(measure))
    length = np.where(some, half_surface * counts * unit ** (1.0 - 1.0 / graph.dim), edges)
    factors: Float = np.divide(INTERFACE_WEIGHT, length, out=np.zeros(len(length)), where=length > 0.0)
    return some / (inertia * whole), factors


def solver_shapes(graph: Graph, labels: Int) -> Float:
    """Return each part's contribution ``(k,)`` to its block's objective F.

    Labels number the parts of all blocks.
    """
    _, means = mass_centres(graph, labels)
    inertia = part_sums(labels, graph.weights * ((graph.centroids - means[labels]) ** 2).sum(axis=1))
    interface = 0.5 * part_cuts(graph, labels, edge_weights=graph.interface)
    block = np.zeros(len(inertia), np.int64)
    block[labels] = graph.block_ids
    heavy, long = solver_factors(graph, np.bincount(block, minlength=graph.n_blocks))
    values: Float = heavy[block] * inertia + long[block] * interface
    return values
