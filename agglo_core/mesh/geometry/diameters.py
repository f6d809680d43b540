"""Compute diameters of blocks of cells: the largest distance between two of their vertices."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Index, Int, Mask, frozen_float, frozen_index, frozen_int
from agglo_core.threads import COSTLY, over_ranges

_NEAR = 1e-12  # relative distance from a limit within which bounds may be wrong by rounding


def diameters_of(offsets: Int, cells: Int, vertex_offsets: Int, vertices: Index, points: Float) -> Float:
    """Return the diameter ``(B,)`` of each block, a set of cells.

    Block b is ``cells[offsets[b]:offsets[b + 1]]``.

    Parameters
    ----------
    offsets : (B + 1,) int
    cells : (n,) int
    vertex_offsets, vertices : CSR
        Vertices per cell.
    points : (p, d) float

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.mesh import diameters_of
    >>> graph = agglo.samples.squares(2).graph
    >>> shape = graph.vertex_offsets, graph.vertices, graph.points
    >>> diameters_of(np.array([0, 1, 4]), np.arange(4), *shape).round(3)  # a cell, and the three others
    array([0.707, 1.414])
    """
    from agglo_core.compiled.geometry import block_diameters

    offsets, cells = frozen_int(offsets), frozen_int(cells)

    def measure_range(start: int, stop: int) -> Float:
        diameters: Float = block_diameters(offsets[start : stop + 1], cells, vertex_offsets, vertices, points)
        return diameters

    return frozen_float(np.concatenate(over_ranges(measure_range, len(offsets) - 1, few=COSTLY, shares=1)))


def compared_diameters(
    offsets: Int, cells: Int, vertex_offsets: Int, vertices: Index, points: Float, limits: Float
) -> Float:
    """Approximate block diameters, closely enough to compare them with increasing ``limits (k,)``.

    The values are exact near a limit, lower bounds elsewhere, and infinite beyond the last limit. This is
    many times faster than :func:`diameters_of`.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.mesh import compared_diameters
    >>> graph = agglo.samples.squares(2).graph
    >>> shape = graph.vertex_offsets, graph.vertices, graph.points
    >>> found = compared_diameters(np.array([0, 1, 4]), np.arange(4), *shape, np.array([1.0]))
    >>> found <= 1.0
    array([ True, False])
    """
    from agglo_core.compiled.geometry import compare_diameters

    offsets, cells, limits = frozen_int(offsets), frozen_int(cells), frozen_float(limits)

    def bound_range(start: int, stop: int) -> Float:
        ranges = offsets[start : stop + 1]
        bounds: Float = compare_diameters(ranges, cells, vertex_offsets, vertices, points, limits)
        return bounds

    return frozen_float(np.concatenate(over_ranges(bound_range, len(offsets) - 1, few=COSTLY, shares=1)))


def wide_parts(
    labels: Int, examined: Mask, limit: float, vertex_offsets: Int, vertices: Index, points: Float
) -> Mask:
    """Return the mask of parts with a diameter above ``limit``, among those in the mask ``examined (k,)``.

    The labels ``(n,)`` are below k.

    One pass over the cells bounds all parts; only parts close to the limit are measured exactly.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.mesh import wide_parts
    >>> graph = agglo.samples.squares(2).graph
    >>> labels, examined = np.array([0, 1, 1, 1]), np.array([True, True])
    >>> wide_parts(labels, examined, 1.0, graph.vertex_offsets, graph.vertices, graph.points)
    array([False,  True])
    """
    from agglo_core.compiled.graphs import list_blocks
    from agglo_core.compiled.part_faults import extend_parts

    labels = frozen_int(labels)

    def bound_range(start: int, stop: int) -> Float:
        thread_bounds = np.empty((len(examined), 8))
        thread_bounds[:, :4], thread_bounds[:, 4:] = np.inf, -np.inf
        extend_parts(start, stop, labels, examined, vertex_offsets, vertices, points, thread_bounds)
        return thread_bounds

    # Extents of each part along fixed directions, from all threads.
    first, *more_bounds = over_ranges(bound_range, len(labels), shares=1)
    least, most = first[:, :4], first[:, 4:]
    for bounds in more_bounds:
        np.minimum(least, bounds[:, :4], out=least)
        np.maximum(most, bounds[:, 4:], out=most)
    # Bounds of the diameter from the extents.
    extents = most - least
    if points.shape[1] == 2:  # a farthest pair lies within 22.5 degrees of one of the four directions
        x, y, u, v = extents.T
        lower = np.maximum(np.maximum(x, y), np.sqrt(0.5) * np.maximum(u, v))
        upper = lower / np.cos(np.pi / 8)
    else:
        lower, upper = extents.max(axis=1), np.sqrt((extents[:, :3] ** 2).sum(axis=1))
    # Measure the parts whose bounds do not decide.
    wide = examined & (lower > limit * (1 + _NEAR))
    near = np.flatnonzero(examined & ~wide & (upper >= limit * (1 - _NEAR)))
    if len(near):
        listed, starts = list_blocks(labels, frozen_int(near), len(examined))
        offsets, shape = frozen_int(starts), (vertex_offsets, vertices, points)
        if points.shape[1] == 2:
            centres = frozen_float(least[near, :2] + 0.5 * extents[near, :2])
            wide[near] = _mark_wide_blocks(offsets, frozen_index(listed), *shape, centres, limit)
        else:  # a vertex belongs to many cells and should be visited once
            wide[near] = diameters_of(offsets, frozen_int(listed), *shape) > limit
    return np.asarray(wide)


def _mark_wide_blocks(
    offsets: Int,
    cells: Index,
    vertex_offsets: Int,
    vertices: Index,
    points: Float,
    centres: Float,
    limit: float,
) -> Mask:
    """Return the mask of blocks with a diameter above ``limit``, from box centres ``(blocks, 2)``."""
    from agglo_core.compiled.widths import wide_blocks

    def test_range(start: int, stop: int) -> Mask:
        arguments = offsets[start : stop + 1], cells, vertex_offsets, vertices, points, centres[start:stop]
        wide: Mask = wide_blocks(*arguments, limit)
        return wide

    return np.concatenate(over_ranges(test_range, len(offsets) - 1, few=COSTLY, shares=1))
