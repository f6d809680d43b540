"""Connect the parts of a partition, and polish them by rounds of simultaneous moves of single cells."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from agglo_core.graph.moves import SHORTNESS
from agglo_gnn.device.graph import (
    DeviceGraph,
    centres,
    components,
    group_max,
    group_min,
    group_sums,
)

_PHASES = (0.5, 0.0, 2.5)
"""Exponents of the interface relative to SHORTNESS, as in refine/compactness/polish."""

_ROUNDS = 96
"""Maximum number of rounds in a phase. On 40,000 triangles parts of 16 cells take 13, parts of 256 cells
all. With half as many rounds, J of the latter is 2 % higher."""

_FEW = 0.2
"""A phase ends when a round has less than this fraction of the largest number of moves. With a quarter of it,
J is up to 0.5 % lower, with half as many rounds again."""

_FLOOR, _SHIFT = 0.5, 12.0  # bounds of the parts' masses, those of the refiner compactness
_TIE = 1e-9  # relative to the terms of a change, for rounding


@dataclass(frozen=True)
class _Sums:
    """Mass, centre of mass, cell count and load of each part, and inertia and interface of all parts."""

    mass: Tensor
    centre: Tensor
    cells: Tensor
    load: Tensor
    inertia: Tensor
    length: Tensor

    @classmethod
    def of(cls, graph: DeviceGraph, labels: Tensor, parts: int) -> _Sums:
        """Sum over the cells of each part."""
        mass, centre, _, _ = centres(graph.centroids, graph.weights, labels, parts)
        distances = ((graph.centroids - centre[labels]) ** 2).sum(1)
        cut = labels[graph.rows] != labels[graph.cols]
        return cls(
            mass,
            centre,
            torch.bincount(labels, minlength=parts),
            group_sums(graph.mass, labels, parts),
            group_sums(graph.weights * distances, torch.zeros_like(labels), 1)[0],
            group_sums(0.5 * graph.lengths * cut, torch.zeros_like(graph.rows), 1)[0],
        )

    def objective(self) -> Tensor:
        """Return the inertia times the interface to the power SHORTNESS."""
        return self.inertia * self.length**SHORTNESS


def mend(graph: DeviceGraph, labels: Tensor, parts: int) -> Tensor:
    """Connect the parts: all components of a part except its largest join an adjacent part.

    A component joins the part with which it has the longest interface. Returns the labels ``(n,)``.
    """
    # 1. The largest component of each part stays, the lowest one of several.
    root = components(graph, labels)
    size = torch.bincount(root, minlength=graph.n)[root]
    largest = (size == group_max(size, labels, parts)[labels]).nonzero()[:, 0]
    kept = group_min(root[largest], labels[largest], parts, graph.n)
    labels = torch.where(root == kept[labels], labels, -1)
    while (labels < 0).any():
        # 2. Interface of each stray component with each adjacent part.
        entries = ((labels[graph.rows] < 0) & (labels[graph.cols] >= 0)).nonzero()[:, 0]
        if len(entries) == 0:
            raise AssertionError("the graph is disconnected")
        keys = root[graph.rows[entries]] * parts + labels[graph.cols[entries]]
        pairs, which = torch.unique(keys, return_inverse=True)
        lengths = group_sums(graph.lengths[entries], which, len(pairs))
        # 3. Join the part with the longest interface, the lowest one of several.
        stray, part = pairs // parts, pairs % parts
        longest = (lengths == group_max(lengths, stray, graph.n)[stray]).nonzero()[:, 0]
        target = group_min(part[longest], stray[longest], graph.n, parts)[root]
        labels = torch.where((labels < 0) & (target < parts), target, labels)
    return labels


def polish(graph: DeviceGraph, labels: Tensor, parts: int) -> Tensor:
    """Move cells between connected parts to lower inertia times interface^SHORTNESS, and return the labels.

    No part is emptied or disconnected, falls below half of its mass, or changes by the mass of more than 12
    mean cells. In a round at most one cell leaves each part and at most one joins it.
    """
    start = _Sums.of(graph, labels, parts)
    change = _SHIFT / start.cells
    bounds = (1.0 - change).clamp(min=_FLOOR) * start.load, (1.0 + change) * start.load
    result, sums = labels, start
    for phase in _PHASES:
        most, stuck = 0, torch.zeros_like(labels, dtype=torch.bool)
        for _ in range(_ROUNDS):
            price = SHORTNESS * phase * sums.inertia / sums.length
            moves = _independent(graph, _gainful(graph, result, sums, bounds, price, stuck), parts)
            torn = _torn(graph, result, moves, parts)
            # Cells that would disconnect their part wait until it changes.
            stuck[moves[0, torn]] = True
            cells, homes, targets = moves[:, ~torn]
            result = result.index_put((cells,), targets)
            changed = torch.zeros(parts, dtype=torch.bool, device=labels.device)
            changed[homes] = changed[targets] = True
            stuck &= ~changed[result]
            sums = _Sums.of(graph, result, parts)
            most = max(most, len(cells))
            if len(cells) <= _FEW * most:
                break
    return result if sums.objective() <= start.objective() else labels


def _gainful(
    graph: DeviceGraph,
    labels: Tensor,
    sums: _Sums,
    bounds: tuple[Tensor, Tensor],
    price: Tensor,
    stuck: Tensor,
) -> Tensor:
    """Return the moves that lower inertia + price · interface, the best first.

    Rows of the result ``(3, q)`` are the cells, their old parts and their new parts.
    """
    # 1. Interface of each boundary cell with each adjacent part, and with its own.
    own, other = labels[graph.rows], labels[graph.cols]
    entries = ((own != other) & ~stuck[graph.rows]).nonzero()[:, 0]
    parts = len(sums.mass)
    pairs, which = torch.unique(graph.rows[entries] * parts + other[entries], return_inverse=True)
    cell, target = pairs // parts, pairs % parts
    home = labels[cell]
    joined = group_sums(graph.lengths[entries], which, len(pairs))
    left = group_sums(graph.lengths * (own == other), graph.rows, graph.n)[cell]
    # 2. Changes in inertia by Steiner's theorem: the old part loses w m / (m − w) |x − c|², the new part
    #    gains w m / (m + w) |x − c|².
    w, x = graph.weights[cell], graph.centroids[cell]
    mass, beyond = sums.mass[home], sums.mass[target]
    loss = w * mass / (mass - w).clamp(min=1e-12 * mass) * ((x - sums.centre[home]) ** 2).sum(1)
    gain = w * beyond / (beyond + w) * ((x - sums.centre[target]) ** 2).sum(1)
    change = gain - loss + price * (left - joined)
    # 3. Gainful moves that respect the bounds, the best first.
    good = change < -_TIE * (gain + loss + price * (left + joined))
    good &= (sums.cells[home] > 1) & (sums.load[home] - graph.mass[cell] >= bounds[0][home])
    good &= sums.load[target] + graph.mass[cell] <= bounds[1][target]
    listed = good.nonzero()[:, 0]
    order = listed[torch.sort(change[listed], stable=True)[1]]
    return torch.stack((cell, home, target))[:, order]


def _independent(graph: DeviceGraph, moves: Tensor, parts: int) -> Tensor:
    """Select at most one move out of each part and one into it, and none of adjacent cells.

    The best move of each old part is taken, then the best of these for each new part, then for each
    cell and its neighbours.
    """
    count = moves.shape[1]
    rank = torch.arange(count, device=moves.device)
    for row in (1, 2):
        kept = group_min(rank, moves[row], parts, count)[moves[row]] == rank
        moves, rank = moves[:, kept], rank[kept]
    ranks = torch.full((graph.n,), count, device=moves.device)
    ranks[moves[0]] = rank
    around = group_min(ranks[graph.cols], graph.rows, graph.n, count)
    return moves[:, rank < around[moves[0]]]


def _torn(graph: DeviceGraph, labels: Tensor, moves: Tensor, parts: int) -> Tensor:
    """Return a mask ``(q,)`` of the moves without whose cell the old part is disconnected.

    At most one cell leaves each part, and cells that join a part are left out.
    """
    numbers = torch.arange(graph.n, device=labels.device)
    apart = labels.index_put((moves[0],), parts + numbers[: moves.shape[1]])
    roots = apart[components(graph, apart) == numbers]
    return torch.bincount(roots, minlength=parts)[moves[1]] > 1
