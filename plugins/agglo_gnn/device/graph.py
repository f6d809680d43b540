"""A dual graph as tensors on one device, with sums and components that do not depend on the device.

Sums over groups are sums of integers, so no order of additions changes them. Sorts are stable, and all other
scattered values are minima or maxima.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from agglo_core.authoring import Graph
from agglo_gnn.paper.network import Neighbours

_SUM_BITS = 60  # bits of a sum in integer units: int64 has 63, and twice a sum must fit as well
TINY = float(np.finfo(np.float64).tiny)  # smallest divisor


@dataclass(frozen=True)
class DeviceGraph:
    """Connected 2-D dual graph as float64 and int64 tensors on one device.

    Attributes
    ----------
    indptr : (n + 1,) tensor; rows, cols : (m,) tensors
        Neighbours ``cols`` of the cells ``rows``, as CSR in both directions.
    lengths : (m,) tensor
        Interface of each entry.
    centroids : (n, 2) tensor
        In units of the largest distance from the first centroid, relative to it.
    measures, weights, mass : (n,) tensors
        In units of their largest value.
    """

    indptr: Tensor
    rows: Tensor
    cols: Tensor
    lengths: Tensor
    centroids: Tensor
    measures: Tensor
    weights: Tensor
    mass: Tensor

    @classmethod
    def of(cls, graph: Graph, device: str) -> DeviceGraph:
        """Copy a graph to a device."""
        indptr, cols = (
            torch.from_numpy(each.astype(np.int64)).to(device) for each in (graph.indptr, graph.indices)
        )
        rows = torch.repeat_interleave(indptr.diff(), output_size=len(cols))
        values = (
            graph.interface,
            graph.centroids - graph.centroids[0],
            graph.measures,
            graph.weights,
            graph.mass,
        )
        return cls(indptr, rows, cols, *(torch.from_numpy(_scaled(each)).to(device) for each in values))

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.mass)

    def neighbours(self, cells: Tensor, blocks: Tensor, n_blocks: int) -> Neighbours:
        """Return the block-diagonal graph on some ``cells (a,)``, sorted by their ``blocks (a,)``."""
        # 1. Entries of the cells, in this order, with the new numbers of their ends.
        degrees = self.indptr.diff()[cells]
        ends = degrees.cumsum(0)
        rows = torch.repeat_interleave(degrees)
        entries = torch.arange(len(rows), device=rows.device) + (self.indptr[cells] + degrees - ends)[rows]
        places = torch.full_like(self.indptr, -1)
        places[cells] = torch.arange(len(cells), device=rows.device)
        cols = places[self.cols[entries]]
        # 2. Keep the entries inside blocks.
        inside = (cols >= 0) & (blocks[cols] == blocks[rows])
        counts = torch.bincount(rows[inside], minlength=len(cells))
        return Neighbours(starts_of(counts), cols[inside], blocks, n_blocks)


def _scaled(values: np.ndarray) -> np.ndarray:
    return values / max(float(np.abs(values).max(initial=0.0)), TINY)


def starts_of(counts: Tensor) -> Tensor:
    """Return 0 and the cumulated sums of the counts ``(n + 1,)``."""
    return torch.nn.functional.pad(counts.cumsum(0), (1, 0))


def to_integers(values: Tensor) -> Tensor:
    """Round ``values`` of size at most 1 to integer units, so small that the sum of all fits into int64."""
    return (values * _units(len(values))).round().to(torch.int64)


def _units(n: int) -> float:
    return 2.0 ** (_SUM_BITS - n.bit_length())


def group_sums(values: Tensor, groups: Tensor, count: int) -> Tensor:
    """Sum ``values (n,)`` or ``(n, f)`` over the groups ``(n,)``, independent of the order.

    The values are rounded to integer units, whose size follows from the largest value of a column.
    """
    if len(values) == 0:
        return values.new_zeros(count, *values.shape[1:])
    scale = values.abs().amax(0).clamp(min=TINY)
    integers = to_integers(values / scale)
    if count == 1:  # a reduction, instead of atomic additions to one address
        sums = integers.sum(0, keepdim=True)
    else:
        sums = integers.new_zeros(count, *values.shape[1:]).index_add_(0, groups, integers)
    return sums * (scale / _units(len(values)))


def group_max(values: Tensor, groups: Tensor, count: int) -> Tensor:
    """Return the maximum of the non-negative ``values (n,)`` in each group ``(count,)``."""
    if count == 1:
        return values.amax(0, keepdim=True)
    return values.new_zeros(count).scatter_reduce_(0, groups, values, "amax")


def group_min(values: Tensor, groups: Tensor, count: int, empty: int) -> Tensor:
    """Return the minimum of the integers ``values (n,)`` in each group ``(count,)``, at most ``empty``."""
    return values.new_full((count,), empty).scatter_reduce_(0, groups, values, "amin")


def relative(values: Tensor, groups: Tensor, count: int) -> Tensor:
    """Return the non-negative ``values (n,)`` over the largest in their group, 1 if that is 0."""
    largest = group_max(values, groups, count)[groups]
    return torch.where(largest > 0, values / largest, 1.0)


def centres(x: Tensor, weights: Tensor, groups: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the weight and the centre of mass of each group, and relative weights and coordinates.

    Weights ``(n,)`` are relative to the largest one in the group, all 1 if that is 0. Coordinates ``(n, 2)``
    are relative to the centre of mass, in units of the largest distance from the first cell along an axis.
    So sums over small groups are as accurate as over large groups.
    """
    numbers = torch.arange(len(x), device=x.device)
    origin = x[group_min(numbers, groups, count, len(x) - 1)]
    w = relative(weights, groups, count)
    local = x - origin[groups]
    size = group_max(local.abs().amax(1), groups, count).clamp(min=TINY)
    local = local / size[groups, None]
    total, *moments = group_sums(torch.stack((w, *(w[:, None] * local).T), 1), groups, count).T
    mean = torch.stack(moments, 1) / total[:, None]
    mass = group_max(weights, groups, count) * total
    return mass, origin + size[:, None] * mean, w, local - mean[groups]


def components(graph: DeviceGraph, labels: Tensor) -> Tensor:
    """Return the lowest cell number ``(n,)`` in each cell's connected component of equal labels."""
    inside = (labels[graph.rows] == labels[graph.cols]).nonzero()[:, 0]
    rows, cols = graph.rows[inside], graph.cols[inside]
    root = torch.arange(graph.n, device=labels.device)
    while True:
        # Each cell takes the lowest root around it, and so does its root. Then roots of roots are taken.
        low = root.scatter_reduce(0, rows, root[cols], "amin")
        low = low.scatter_reduce(0, root, low, "amin")
        low = low[low]
        if torch.equal(low, root):
            return root
        root = low
