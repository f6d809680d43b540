"""The k-way polish: compact parts with short interfaces."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, UInt64, frozen_float, frozen_int
from agglo_core.components.refiners import checked_floor
from agglo_core.graph import Graph
from agglo_core.graph.functionals import ratio
from agglo_core.graph.moves import SHORTNESS, part_sums
from agglo_core.graph.objectives import numbered_parts
from agglo_core.protocols import Target

__all__ = ["CompactnessRefiner"]

_FLAT = 1e-6
"""A third moment below this share of its bound is rounding."""


class CompactnessRefiner:
    """Moves boundary cells to where parts become compact and their interfaces short.

    It lowers, in each block, J · L^0.3: J is the moment of inertia of the parts, the energy of k-means, and
    L the length of the interfaces. The product has no unit, so neither scale nor number of parts matter.
    Sweeps of single-cell moves go over the boundary cells of all parts until none pays; they take the cells
    along an axis of the block, so the result does not depend on cell numbering. No part is emptied or
    disconnected, none falls below ``floor`` times its measure at entry, and if the target is a size, none
    that meets it becomes too wide.

    Parameters
    ----------
    floor : float in [0, 1]

    Raises
    ------
    OptionError
        If ``floor`` is anything else.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core import samples
    >>> from agglo_core.components.compactness import CompactnessRefiner
    >>> from agglo_core.protocols import Target
    >>> graph = samples.squares(4).graph  # 4 x 4 cells in columns, from below
    >>> dented = np.array([0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 1])
    >>> CompactnessRefiner().refine(graph, dented, np.zeros(1, np.uint64), Target(parts=2)).reshape(4, 4)
    array([[0, 0, 1, 1],
           [0, 0, 1, 1],
           [0, 0, 1, 1],
           [0, 0, 1, 1]])
    """

    objective = "shape"

    def __init__(self, floor: float = 0.5) -> None:
        self.floor = checked_floor("compactness", floor)

    def refine(self, graph: Graph, labels: Int, seeds: UInt64, target: Target) -> Int:
        """Labels ``(n,)`` after the sweeps; seeds are not used."""
        parts = numbered_parts(graph, labels)
        k = int(parts.max(initial=-1)) + 1
        local, block = np.empty(k, np.int64), np.empty(k, np.int64)
        local[parts], block[parts] = labels, graph.block_ids
        return frozen_int(local[self.refine_parts(graph, parts, frozen_int(block), target)])

    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int:
        """Labels ``(n,)`` after the sweeps; part p may trade cells with parts of ``block[p]`` alone."""
        from agglo_core.kernels.shape_sweeps import relax_shapes

        axes, places = _axes(graph, block[labels], int(block.max(initial=-1)) + 1)
        return frozen_int(
            relax_shapes(
                (graph.indptr, graph.indices, graph.interface),
                (graph.centroids, graph.weights),
                graph.measures,
                labels,
                block,
                axes,
                places,
                SHORTNESS,
                self.floor,
                np.inf if target.h_star is None else float(target.h_star),
                (graph.vertex_offsets, graph.vertices, graph.points, *_directions(graph.dim)),
            )
        )


def _axes(graph: Graph, block: Int, count: int) -> tuple[Float, Float]:
    """An axis of each of ``count`` blocks ``(B, d)``, and the place of each cell along it ``(n,)``.

    It is the third moment about the centre, which turns with the block and is not zero unless there is
    symmetry; then it is one fixed direction.
    """
    w, x = graph.weights, graph.centroids
    centres = [ratio(part_sums(block, w * each, count), part_sums(block, w, count)) for each in x.T]
    offsets = x - np.stack(centres, axis=1)[block]
    largest = np.abs(offsets).max(initial=0.0)
    offsets = np.ldexp(offsets, -np.frexp(largest)[1])  # cubes of any unit are finite
    square = (offsets**2).sum(axis=1)
    axes = np.stack([part_sums(block, w * square * each, count) for each in offsets.T], axis=1)
    flat = np.linalg.norm(axes, axis=1) <= _FLAT * part_sums(block, w * square**1.5, count)
    axes[flat] = 1.0 / (1.0 + np.sqrt(2.0) * np.arange(graph.dim))
    return frozen_float(axes), frozen_float((axes[block] * x).sum(axis=1))


def _directions(dim: int) -> tuple[Float, float]:
    """Unit vectors ``(D, dim)``, and the cosine of the largest angle that any direction makes with the next.

    In space they go through the corners, the middles of edges and of faces of a cube.
    """
    if dim == 2:
        angles = np.arange(8) * np.pi / 8
        return frozen_float(np.stack((np.cos(angles), np.sin(angles)), axis=1)), float(np.cos(np.pi / 16))
    steps = np.array([step for step in np.ndindex(3, 3, 3) if step > (1, 1, 1)]) - 1.0
    unit = frozen_float(steps / np.linalg.norm(steps, axis=1)[:, None])
    return unit, float(1.0 / np.sqrt(1.0 + (np.sqrt(2.0) - 1.0) ** 2 + (np.sqrt(3.0) - np.sqrt(2.0)) ** 2))
