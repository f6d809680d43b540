"""Parts around the points of a hexagonal lattice, a start for k-way partitions in 2-D."""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from agglo_core.authoring import Float, Graph, Int, frozen_int
from agglo_core.graph.frame import moving_frame

_SHIFTS = (0.0, 0.25, 0.5)
"""Positions of the first lattice point in even rows, relative to the spacing.

With one, parts of a few dozen cells at straight outlines and in narrow domains are less compact
(benchmarks/solver_shapes.py --objective).
"""

_SPARSE = 100
"""Largest number of lattice points per cell, a safeguard: more arise if measures are no areas."""


def lattice_parts(graph: Graph, k: int) -> Int | None:
    """Assign each cell to the nearest of k points of a hexagonal lattice, and return the labels ``(n,)``.

    Of several lattices, with rows along either axis of the graph's moving frame, the labels have the lowest
    moment of inertia. Returns None if no lattice has k points with cells, or the graph is not 2-D.
    """
    best, least = None, np.inf
    if graph.dim != 2 or not graph.measures.any():
        return None
    local = graph.centroids @ moving_frame(graph.centroids, graph.weights).T
    for axis, shift in product((0, 1), _SHIFTS):
        labels, distances = _nearest(local[:, [axis, 1 - axis]], graph.measures, k, shift)
        inertia = float(graph.weights @ distances**2) if len(labels) else np.inf
        if inertia < least:
            best, least = frozen_int(labels), inertia
    return best


def _nearest(places: Float, measures: Float, k: int, shift: float) -> tuple[Int, Float]:
    """Return the nearest of k lattice points, and its distance, for each cell at ``places (n, 2)``.

    The rows of the lattice are parallel to the first axis. Returns empty arrays if fewer than k points have
    cells.
    """
    # 1. Rows that fill the height of the domain, with one point per mean measure of a part.
    unit, margin = float(measures.sum()) / k, 0.5 * float(measures.mean()) ** 0.5
    low = places.min(axis=0) - margin
    width, height = places.max(axis=0) + margin - low
    n_rows = max(1, round(height / (unit * 3.0**0.5 / 2.0) ** 0.5))
    steps = np.array([unit * n_rows / height, height / n_rows])
    n_columns = int(width / steps[0]) + 4
    if n_rows * n_columns > _SPARSE * len(places):
        return frozen_int([]), np.empty(0)
    x, y = ((places - low) / steps).T
    # 2. Even and odd rows form rectangular lattices, in which the nearest point follows from rounding.
    least, row, column = np.full(len(x), np.inf), np.zeros(len(x)), np.zeros(len(x))
    for odd in range(min(2, n_rows)):
        last = n_rows - 1 - (n_rows - 1 - odd) % 2
        near_row = np.clip(2.0 * np.rint((y - 0.5 - odd) / 2.0) + odd, odd, last)
        offset = shift + 0.5 * odd
        near_column = np.rint(x - offset)
        squares = ((x - offset - near_column) * steps[0]) ** 2 + ((y - 0.5 - near_row) * steps[1]) ** 2
        nearer = squares < least
        least = np.where(nearer, squares, least)
        row, column = np.where(nearer, near_row, row), np.where(nearer, near_column, column)
    # 3. Keep the k points with the heaviest cells, since points at the outline have few cells.
    point = (row * n_columns + column + 1.0).astype(np.int64)
    totals = np.bincount(point, measures, n_rows * n_columns)
    if np.count_nonzero(totals) < k:
        return frozen_int([]), np.empty(0)
    kept = np.sort(np.argsort(-totals, kind="stable")[:k])
    number = np.full(len(totals), -1)
    number[kept] = np.arange(k)
    labels, distances = number[point], np.sqrt(least)
    # 4. The cells of the other points go to the nearest point that is kept.
    lost, (rows, columns) = labels < 0, np.divmod(kept, n_columns)
    points = steps * np.stack((columns - 1.0 + shift + 0.5 * (rows % 2), rows + 0.5), axis=1)
    distances[lost], labels[lost] = cKDTree(points).query(places[lost] - low)
    return frozen_int(labels), distances
