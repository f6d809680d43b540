"""Communication plan for multiplicative patch smoothing across ranks: order, required rows, updates.

Ranks with adjacent patches take turns, by colours: M. F. Adams, "A distributed memory unstructured
Gauss-Seidel algorithm for multigrid smoothers", Proc. SC 2001. Patches away from the borders touch no other
rank: all ranks sweep through them concurrently.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Int, Patches, frozen_int
from agglo_petsc.messages import by_owner, exchange_parcels

_EMPTY = frozen_int(np.empty(0, np.int64))  # no parts


@dataclass(frozen=True, eq=False)
class BorderPlan:
    """Data of one rank for multiplicative smoothing over patches shared with other ranks.

    Own parts come first, then copies of parts on other ranks, both by increasing number.

    Attributes
    ----------
    inner, outer : Patches
        ``inner`` patches touch no other rank, given by own parts; all others are ``outer``, given by own
        parts and copies.
    rows : bsr
        Rows of all parts in ``outer``, square; other rows are empty.
    copied, copies : mapping of rank to (m,) int
        Own parts copied to that rank; copies of its parts.
    receivers, senders : mapping of rank to (m,) int
        Parts in ``outer`` that the rank has, too; parts that it changes.
    colours : mapping of rank to int
        Turns of this rank, if it has such patches, and of all ``senders``.
    """

    inner: Patches
    outer: Patches
    rows: Any
    copied: Mapping[int, Int]
    copies: Mapping[int, Int]
    receivers: Mapping[int, Int]
    senders: Mapping[int, Int]
    colours: Mapping[int, int]


def border_plan(comm: Any, own: Any, starts: Int, patches: Patches | None) -> BorderPlan:
    """Compute the plan for multiplicative smoothing over distributed patches. Collective.

    Parameters
    ----------
    comm : mpi4py communicator
    own : bsr
        Rows of this rank, all columns, with a block for each pair of parts.
    starts : (ranks + 1,) int
        Rank r has the parts ``starts[r]:starts[r + 1]``.
    patches : Patches, optional
        By global numbers. Parts in no patch on any rank form single patches.
    """
    # 1. Divide the patches into inner and outer
    first, last = int(starts[comm.rank]), int(starts[comm.rank + 1])
    groups = _with_single_parts(comm, starts, patches)
    inner, outer = _divide_patches(groups, own, first, last)
    # 2. Collect the rows of changed parts, and the parts to copy
    changed = frozen_int(np.unique(outer.parts))
    rows, ids = _rows_for(comm, own, starts, changed)
    reached = np.unique(np.concatenate((ids, changed)))
    ghosts = frozen_int(reached[(reached < first) | (reached >= last)])

    def to_local(parts: Int) -> Int:
        """Return the local indices of parts: first the parts owned by this rank, then ghosts."""
        inside = (parts >= first) & (parts < last)
        return frozen_int(np.where(inside, parts - first, last - first + np.searchsorted(ghosts, parts)))

    # 3. Exchange the lists of copies and updates
    requests = by_owner(ghosts, starts)
    copied = {
        rank: frozen_int(part_ids - first) for rank, part_ids in exchange_parcels(comm, requests).items()
    }
    updates, senders = _tellers(comm, starts, changed, copied)
    matrix = _square(rows, to_local(changed), to_local(ids), last - first + len(ghosts), own.blocksize[0])
    return BorderPlan(
        inner=Patches(inner.offsets, frozen_int(inner.parts - first)),
        outer=Patches(outer.offsets, to_local(frozen_int(outer.parts))),
        rows=matrix,
        copied=copied,
        copies={rank: to_local(part_ids) for rank, part_ids in requests.items()},
        receivers={rank: to_local(part_ids) for rank, part_ids in updates.items()},
        senders={rank: to_local(part_ids) for rank, part_ids in senders.items()},
        colours=_colours(comm, sorted(updates)),
    )


def in_blocks(rows: Any, width: int) -> Any:
    """Convert a CSR matrix to BSR with square blocks and sorted column indices."""
    found = sparse.bsr_array(rows, blocksize=(width, width))
    found.sort_indices()
    return found


def _with_single_parts(comm: Any, starts: Int, patches: Patches | None) -> Patches:
    """Return this rank's patches, with a single-part patch for each own part that is in no patch."""
    first, last = int(starts[comm.rank]), int(starts[comm.rank + 1])
    offsets, parts = (np.zeros(1, np.int64), _EMPTY) if patches is None else (patches.offsets, patches.parts)
    held = exchange_parcels(comm, by_owner(frozen_int(np.unique(parts)), starts)).values()
    alone = np.ones(last - first, bool)
    for each in held:
        alone[each - first] = False
    sizes, single = np.diff(offsets), first + np.flatnonzero(alone)
    sizes = np.concatenate((sizes[sizes > 0], np.ones(len(single), np.int64)))
    return Patches(starts_of(sizes), frozen_int(np.concatenate((parts, single))))


def _divide_patches(groups: Patches, rows: Any, first: int, last: int) -> tuple[Patches, Patches]:
    """Split patches into those with all parts and neighbours on this rank, and all others."""
    away = (rows.indices < first) | (rows.indices >= last)
    coupled = np.zeros(last - first, bool)
    coupled[np.repeat(np.arange(last - first), np.diff(rows.indptr))[away]] = True
    inside = (groups.parts >= first) & (groups.parts < last)
    free = np.zeros(len(groups.parts), bool)
    free[inside] = ~coupled[groups.parts[inside] - first]
    group = np.repeat(np.arange(len(groups)), np.diff(groups.offsets))
    inner = np.bincount(group[~free], minlength=len(groups)) == 0
    return tuple(
        Patches(starts_of(np.diff(groups.offsets)[mask]), frozen_int(groups.parts[mask[group]]))
        for mask in (inner, ~inner)
    )  # type: ignore[return-value]


def _rows_for(comm: Any, rows: Any, starts: Int, parts: Int) -> tuple[tuple[Any, Any, Any], Int]:
    """Collect the block rows of given parts from all ranks, own rows first, and return their columns, too."""
    first, requests = int(starts[comm.rank]), by_owner(parts, starts)
    own_parts = requests.pop(comm.rank, _EMPTY)
    answers = {
        rank: _take_rows(rows, frozen_int(item - first))
        for rank, item in exchange_parcels(comm, requests).items()
    }
    pieces = [_take_rows(rows, frozen_int(own_parts - first)), *exchange_parcels(comm, answers).values()]
    counts, columns, blocks = (np.concatenate(item) for item in zip(*pieces, strict=True))
    return (counts, columns, blocks), frozen_int(columns)


def _take_rows(rows: Any, selection: Int) -> tuple[Any, Any, Any]:
    """Return selected block rows of a BSR matrix: block counts, column indices, blocks."""
    counts = np.diff(rows.indptr)[selection]
    ends = np.cumsum(counts)
    total = int(ends[-1]) if len(ends) else 0
    at = np.repeat(rows.indptr[selection] - ends + counts, counts) + np.arange(total)
    return counts, rows.indices[at], rows.data[at]


def _square(rows: tuple[Any, Any, Any], places: Int, columns: Int, n: int, width: int) -> Any:
    """Return the square BSR matrix with the given block rows, and all other rows empty."""
    counts, _, blocks = rows
    order = np.argsort(places, kind="stable")  # own parts first, like the rows
    sizes = np.zeros(n, np.int64)
    sizes[places[order]] = counts
    arrays = blocks, np.array(columns), np.array(starts_of(sizes))  # copies, as sorting is in place
    found = sparse.bsr_array(arrays, shape=(n * width, n * width))
    found.sort_indices()
    return found


def _tellers(
    comm: Any, starts: Int, changed: Int, copied: Mapping[int, Int]
) -> tuple[dict[int, Int], dict[int, Int]]:
    """Return per other rank the parts changed here that it holds, and held here that it changes.

    The owner of a part sends the list of its copies to the ranks that change the part.
    """
    # 1. Ranks that change own parts, and ranks that hold them
    first, count = int(starts[comm.rank]), int(starts[comm.rank + 1] - starts[comm.rank])
    writers = exchange_parcels(comm, by_owner(changed, starts))
    holders = dict(copied) | {comm.rank: np.arange(count)}
    has = {rank: np.isin(np.arange(count), values) for rank, values in holders.items()}
    # 2. Answer each writer with the holders
    answers: dict[int, dict[int, Any]] = {}
    for writer, parts in writers.items():
        shared = {rank: parts[values[parts - first]] for rank, values in has.items() if rank != writer}
        answers[writer] = {rank: values for rank, values in shared.items() if len(values)}
    # 3. Merge the answers
    pieces: dict[int, list[Int]] = {}
    for answer in exchange_parcels(comm, answers).values():
        for rank, parts in answer.items():
            pieces.setdefault(rank, []).append(parts)
    updates = {rank: frozen_int(np.concatenate(pieces[rank])) for rank in sorted(pieces)}
    return updates, exchange_parcels(comm, updates)


def _colours(comm: Any, touched: list[int]) -> dict[int, int]:
    """Return a colour for each rank, such that ranks that change a common part differ."""
    # 1. Adjacent ranks
    adjacent: list[set[int]] = [set() for _ in range(comm.size)]
    for rank, neighbours in enumerate(comm.allgather(touched)):
        for neighbour in neighbours:
            adjacent[rank].add(neighbour)
            adjacent[neighbour].add(rank)
    # 2. Greedy colouring
    colours: dict[int, int] = {}
    for rank, neighbours in enumerate(adjacent):
        used_colours = {colours[neighbour] for neighbour in neighbours if neighbour in colours}
        colours[rank] = next(colour for colour in range(comm.size + 1) if colour not in used_colours)
    return colours


def starts_of(sizes: Any) -> Int:
    """Return the offsets ``(n + 1,)`` of consecutive lists with the given sizes."""
    return frozen_int(np.concatenate(([0], np.cumsum(sizes))))
