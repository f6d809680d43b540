"""Recursive bisection by a network, with one evaluation for all pieces at a depth."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from agglo_core.authoring import PluginError
from agglo_gnn.device.graph import (
    TINY,
    DeviceGraph,
    centres,
    group_max,
    group_sums,
    relative,
    starts_of,
    to_integers,
)
from agglo_gnn.paper.network import Neighbours

_ISOTROPIC = 0.9  # ratio of second moments above which fourth moments determine the axes, as in graph/blocks
_SLACK = 0.05  # largest relative difference between the share and the quota of a side, for a cut that stays

Odds = Callable[[Tensor, Neighbours], Tensor]
"""Function of features ``(a, 3)`` and edges that returns the log odds of side 1 ``(a,)``."""


def bisect_to_parts(graph: DeviceGraph, parts: int, odds: Odds) -> Tensor:
    """Bisect the graph depth by depth into exactly ``parts`` parts, and return the labels ``(n,)``.

    Parts are non-empty, and may be disconnected.
    """
    device = graph.mass.device
    labels = torch.zeros(graph.n, dtype=torch.int64, device=device)
    cells, blocks = torch.arange(graph.n, device=device), torch.zeros_like(labels)
    # Number of parts of each block, and the label of its first part.
    quotas, first = torch.tensor([[parts], [0]], device=device)
    while parts > 1:
        # 1. Evaluate the network on all blocks, and cut each block.
        n_blocks = len(quotas)
        x = features(graph, cells, blocks, n_blocks)
        scores = odds(x, graph.neighbours(cells, blocks, n_blocks))
        if not scores.isfinite().all():
            raise PluginError("the network returned log odds that are not finite")
        sides, lower = cut(scores, graph.mass[cells], blocks, quotas)
        # 2. Both sides of each block, with their labels.
        blocks = 2 * blocks + sides
        first = torch.stack((first, first + lower), 1).flatten()
        quotas = torch.stack((lower, quotas - lower), 1).flatten()
        labels[cells] = first[blocks]
        # 3. Keep the sides of several parts, sorted by side.
        unfinished = quotas > 1
        keep = unfinished[blocks].nonzero()[:, 0]
        if len(keep) == 0:
            break
        keep = keep[torch.sort(blocks[keep], stable=True)[1]]
        cells, blocks = cells[keep], (unfinished.cumsum(0) - 1)[blocks[keep]]
        quotas, first = quotas[unfinished], first[unfinished]
    return labels


def features(graph: DeviceGraph, cells: Tensor, blocks: Tensor, count: int) -> Tensor:
    """Return the network inputs ``(a, 3)`` of :func:`agglo_gnn.paper.network.inorm` for some cells."""
    _, _, w, local = centres(graph.centroids[cells], graph.weights[cells], blocks, count)
    x, y = local.T

    def rotate(angle: Tensor) -> tuple[Tensor, Tensor]:
        cos, sin = angle.cos()[blocks], angle.sin()[blocks]
        return cos * x + sin * y, cos * y - sin * x

    # 1. Principal axes. With equal second moments, the axes of the smallest fourth moments.
    xx, xy, yy = group_sums(w[:, None] * torch.stack((x * x, x * y, y * y), 1), blocks, count).T
    spread = torch.hypot(xx - yy, 2.0 * xy)
    isotropic = xx + yy - spread >= _ISOTROPIC * (xx + yy + spread)
    x, y = rotate(0.5 * torch.atan2(2.0 * xy, xx - yy))
    real, imaginary = x * x - y * y, 2.0 * x * y
    fourth = torch.stack((real * real - imaginary * imaginary, 2.0 * real * imaginary), 1)
    one, two = group_sums(w[:, None] * fourth, blocks, count).T
    x, y = rotate(torch.where(isotropic, torch.atan2(-two, -one) / 4, 0.0))
    # 2. The axis of the larger second moment first, and each axis towards its heavier tail.
    xx, yy, xxx, yyy = group_sums(w[:, None] * torch.stack((x**2, y**2, x**3, y**3), 1), blocks, count).T
    x, y = torch.where(xxx < 0, -1.0, 1.0)[blocks] * x, torch.where(yyy < 0, -1.0, 1.0)[blocks] * y
    x, y = torch.where((yy > xx)[blocks], torch.stack((y, x)), torch.stack((x, y)))
    # 3. Measures and coordinates in units of the largest.
    measures = graph.measures[cells]
    largest = group_max(measures, blocks, count).clamp(min=TINY)[blocks]
    extent = group_max(torch.maximum(x.abs(), y.abs()), blocks, count).clamp(min=TINY)[blocks]
    return torch.stack((measures / largest, x / extent, y / extent), 1)


def cut(scores: Tensor, mass: Tensor, blocks: Tensor, quotas: Tensor) -> tuple[Tensor, Tensor]:
    """Cut each block by the scores, and return the sides ``(a,)`` and the number of parts of side 0 ``(B,)``.

    Side 0 are the cells with negative scores. If the masses of the sides are not in proportion to whole
    numbers of parts, or one side has less than a quarter of the parts, the cut moves along the sorted scores.
    """
    # 1. Integer masses below each cell in its block, in the order of the scores.
    order = torch.sort(scores, stable=True)[1]
    order = order[torch.sort(blocks[order], stable=True)[1]]  # blocks are sorted, so they keep their places
    sizes = torch.bincount(blocks, minlength=len(quotas))
    starts = starts_of(sizes)[:-1]
    units = to_integers(relative(mass, blocks, len(quotas))[order])
    below = starts_of(units)[:-1]
    below = below - below[starts][blocks]
    total = torch.zeros_like(quotas).index_add_(0, blocks, units)
    # 2. Parts of the side with negative scores, about in proportion to its mass.
    negative = scores[order] < 0
    share = torch.zeros_like(quotas).index_add_(0, blocks, units * negative).double() / total * quotas
    lower = share.round().to(torch.int64)
    lower = torch.minimum(torch.maximum(lower, (quotas + 3) // 4), quotas - (quotas + 3) // 4)
    moved = (share - lower).abs() > _SLACK * torch.minimum(lower, quotas - lower)
    # 3. Move the cut to the cell whose midpoint is nearest, and leave each side a cell for each part.
    bound = 2.0 * total.double() * lower / quotas
    upper = torch.where(moved[blocks], 2 * below + units > bound[blocks], ~negative)
    rank = torch.arange(len(scores), device=scores.device) - starts[blocks]
    upper = (upper | (rank >= (sizes - quotas + lower)[blocks])) & (rank >= lower[blocks])
    sides = torch.empty_like(blocks)
    sides[order] = upper.to(torch.int64)
    return sides, lower
