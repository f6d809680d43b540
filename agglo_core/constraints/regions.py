"""Constraints that separate cells: regions, and cells that remain parts of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, Mask, owned, plain_array
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh.marks import in_group


class Regions:
    """Constraint: no part contains cells from two regions (materials, tissues, layers).

    Parameters
    ----------
    tags : str or tuple of str
        Cell tags. Cells belong to one region if all their tags agree.
    values : (n,) array, optional
        The region per cell, instead of tags.

    Examples
    --------
    >>> import numpy as np, agglo_core as agglo
    >>> mesh = agglo.samples.squares(4)
    >>> halves = mesh.cell_centroids[:, 0] > 0.5
    >>> hierarchy = agglo.agglomerate(mesh, n_parts=5, regions=halves)
    >>> [len(np.unique(halves[hierarchy.levels[0] == part])) for part in range(5)]
    [1, 1, 1, 1, 1]
    """

    def __init__(self, tags: str | tuple[str, ...] = "region", values: Int | Mask | None = None) -> None:
        self.tags = (tags,) if isinstance(tags, str) else tuple(tags)
        self.values = None if values is None else owned(plain_array(values, "regions", OptionError))

    def forbidden(self, graph: Graph) -> Mask:
        """Return a mask ``(m,)`` of the dual edges between different regions."""
        columns = [_of_cells(graph, tag) for tag in self.tags] if self.values is None else [self.values]
        different = np.zeros(len(graph.indices), bool)
        degrees = np.diff(graph.indptr)
        for column in columns:
            if column.shape != (graph.n,):
                raise OptionError(
                    f"regions have shape {column.shape}, expected ({graph.n},): one value for each cell"
                )
            small = _narrow(column)
            different |= np.repeat(small, degrees) != small.take(graph.indices)
        return different


def _narrow(values: NDArray[Any]) -> NDArray[Any]:
    """Convert integers to one byte each if their range permits, for ten times faster comparisons."""
    if values.dtype.kind in "iu" and values.size and values.max() - values.min() < 256:
        small: NDArray[Any] = (values - values.min()).astype(np.uint8)
        return small
    return values


class Where:
    """Constraint: agglomerate only marked cells, and keep every other cell as a part of its own.

    Parameters
    ----------
    tag : str
        Cell tag that marks the cells to agglomerate, where its value is neither 0 nor −1.
    values : tuple of int
        Tag values that mark these cells instead.
    """

    def __init__(self, tag: str = "region", values: tuple[int, ...] = ()) -> None:
        self.tag, self.values = tag, tuple(values)

    def forbidden(self, graph: Graph) -> Mask:
        """Return a mask ``(m,)`` of the dual edges at cells that remain parts of their own."""
        tag = _of_cells(graph, self.tag)
        return beside(graph, ~(np.isin(tag, self.values) if self.values else in_group(tag)))


class SingleCells:
    """Constraint: every marked cell remains a part of its own.

    Parameters
    ----------
    alone : (n,) bool
    """

    def __init__(self, alone: Mask) -> None:
        self.alone = alone

    def forbidden(self, graph: Graph) -> Mask:
        """Return a mask ``(m,)`` of the dual edges at cells that remain parts of their own."""
        return beside(graph, self.alone)


def beside(graph: Graph, marked: Mask) -> Mask:
    """Return a mask ``(m,)`` of the dual edges with a marked cell at either end."""
    found: Mask = np.repeat(marked, np.diff(graph.indptr)) | marked[graph.indices]
    return found


def _of_cells(graph: Graph, tag: str) -> Int:
    if tag not in graph.data:
        known = f"there are {', '.join(graph.data)}" if graph.data else "there are none"
        raise OptionError(f"no cell tag is named {tag!r}; {known}")
    return graph.data[tag]
