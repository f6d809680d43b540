"""First domains of a distributed run: each rank's cells, or blocks independent of ranks."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from agglo_core.arrays import Int, frozen_float, frozen_int
from agglo_core.distributed.agglomeration.cells import Cells, mark_pairs
from agglo_core.distributed.agglomeration.domain import Domain, Links
from agglo_core.distributed.agglomeration.rules import Kept


def first_domains(cells: Cells, kept: Kept, block: Int, ours: Iterable[int]) -> list[tuple[int, Domain]]:
    """Return this rank's share of each domain, for domain numbers ``block (n,)`` on cells and ghosts.

    There is one domain per block with own cells, and one per number in ``ours``, possibly without cells.
    """
    # Sort the own cells by block, with graphs of the blocks.
    graph, rows, is_own = cells.graph, cells.rows, cells.own
    in_block = is_own[rows] & is_own[graph.indices] & (block[rows] == block[graph.indices])
    nodes = np.flatnonzero(is_own)
    nodes = nodes[np.argsort(block[nodes], kind="stable")]
    numbers = np.union1d(block[nodes], np.array(list(ours), np.int64))
    offsets = np.searchsorted(block[nodes], np.append(numbers, numbers.max(initial=0) + 1))
    allowed = graph.without_edges(kept.forbidden & in_block)
    level = allowed.subgraph(nodes, offsets)
    place = np.full(graph.n, -1)
    place[nodes] = np.arange(len(nodes)) - np.repeat(offsets[:-1], np.diff(offsets))
    # Barriers within blocks, and links to other blocks or ranks.
    pairs = kept.barriers[(is_own[kept.barriers]).any(axis=1)]
    inner = pairs[is_own[pairs].all(axis=1) & (block[pairs[:, 0]] == block[pairs[:, 1]])]
    beyond = np.flatnonzero(is_own[rows] & ~in_block)
    row, column = rows[beyond], graph.indices[beyond].astype(np.int64)
    links = Links(
        frozen_int(place[row]),
        frozen_int(cells.ids[column]),
        frozen_int(block[column]),
        frozen_float(graph.interface[beyond]),
        kept.forbidden[beyond],
        mark_pairs(row, column, pairs, graph.n),
    )
    # Assemble the domain of each block.
    domains = []
    for i, number in enumerate(numbers.tolist()):
        inside, of_block = nodes[offsets[i] : offsets[i + 1]], block[row] == number
        barriers = np.sort(place[inner[block[inner[:, 0]] == number]], axis=1)
        domain = Domain(
            level[i],
            frozen_int(cells.ids[inside]),
            frozen_int(np.ones(len(inside))),
            frozen_float(kept.weights[inside]),
            frozen_int(np.unique(barriers, axis=0).reshape(-1, 2)),
            links.chosen(of_block),
        )
        domains.append((number, domain))
    return domains
