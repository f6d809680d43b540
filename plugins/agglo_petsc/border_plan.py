"""Patches at the borders of ranks: whose turn it is, which rows they need, who is told what they change.

Ranks with patches that touch one another take turns, by colours: M. F. Adams, "A distributed memory
unstructured Gauss-Seidel algorithm for multigrid smoothers", Proc. SC 2001. Patches farther inside touch
nothing that other ranks see: each rank sweeps through them while it waits for others, or others for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Int, Mask, Patches, frozen_int
from agglo_petsc.rank_messages import by_owner, swapped

__all__ = ["BorderPlan", "border_plan", "in_blocks", "starts_of"]

_EMPTY = frozen_int(np.empty(0, np.int64))


@dataclass(frozen=True, eq=False)
class BorderPlan:
    """What a rank has to know for sweeps through patches that others touch, too.

    Its border are the parts that its patches there see, and those that other ranks see there, by rising
    number: some own ones in a row, and copies of parts of other ranks.

    Attributes
    ----------
    inner, outer : Patches
        Those that change nothing others see, and see nothing others change, by own parts; the rest, by places
        in the border.
    rows : bsr
        The rows of all parts in ``outer``, square, by places; those of other parts are empty.
    own, places : (m,) int
        The own parts of the border, and their places in it.
    shared, shared_places : (m,) int
        Those of them that other ranks see.
    copied : mapping of rank to (m,) int
        Own parts of which that rank has copies.
    copies : mapping of rank to (m,) int
        Places of the copies of its parts.
    told, tellers : mapping of rank to (m,) int
        Places of parts that this rank changes and that one has, too; of those that that one changes.
    colours : mapping of rank to int
        Turns: of this rank, if it has such patches, and of all ``tellers``.
    """

    inner: Patches
    outer: Patches
    rows: Any
    own: Int
    places: Int
    shared: Int
    shared_places: Int
    copied: Mapping[int, Int]
    copies: Mapping[int, Int]
    told: Mapping[int, Int]
    tellers: Mapping[int, Int]
    colours: Mapping[int, int]


def border_plan(comm: Any, own: Any, starts: Int, patches: Patches | None) -> BorderPlan:
    """Plan sweeps through patches that are given by one rank each; collective.

    Parameters
    ----------
    comm : mpi4py communicator
    own : bsr
        Rows of this rank, all columns, a block for each pair of parts.
    starts : (ranks + 1,) int
        Rank r has the parts ``starts[r]:starts[r + 1]``.
    patches : Patches, optional
        By numbers of all ranks. Parts in none of any rank are patches of their own.
    """
    first, last = int(starts[comm.rank]), int(starts[comm.rank + 1])
    groups = _with_single_parts(comm, starts, patches)
    near = _near_others(groups, own, first, last)
    rows, away = _rows_seen(comm, own, starts, frozen_int(np.unique(_chosen(groups, near).parts)))
    asked = by_owner(away, starts)
    copied = {rank: frozen_int(each - first) for rank, each in swapped(comm, asked).items()}
    shared = frozen_int(np.unique(np.concatenate([_EMPTY, *copied.values()])))
    outer = near | _touches(groups, own, shared, first, last)
    inside, border = _chosen(groups, ~outer), _chosen(groups, outer)
    changed = frozen_int(np.unique(border.parts))
    mine = frozen_int(changed[(changed >= first) & (changed < last)] - first)
    all_rows = [_taken(own, mine), *rows]
    seen = np.unique(np.concatenate((changed, away, first + shared, *(each[1] for each in all_rows))))
    told, tellers = _tellers(comm, starts, changed, copied)

    def here(parts: Int) -> Int:
        """Places in the border."""
        return frozen_int(np.searchsorted(seen, parts))

    kept = frozen_int(seen[(seen >= first) & (seen < last)])
    counts, columns, blocks = (np.concatenate(each) for each in zip(*all_rows, strict=True))
    ordered = np.concatenate((mine + first, changed[(changed < first) | (changed >= last)]))
    return BorderPlan(
        inner=Patches(inside.offsets, frozen_int(inside.parts - first)),
        outer=Patches(border.offsets, here(border.parts)),
        rows=_square((counts, here(columns), blocks), here(ordered), len(seen), own.blocksize[0]),
        own=frozen_int(kept - first),
        places=here(kept),
        shared=shared,
        shared_places=here(frozen_int(first + shared)),
        copied=copied,
        copies={rank: here(each) for rank, each in asked.items()},
        told={rank: here(each) for rank, each in told.items()},
        tellers={rank: here(each) for rank, each in tellers.items()},
        colours=_colours(comm, sorted(told)),
    )


def in_blocks(rows: Any, width: int) -> Any:
    """A CSR as BSR with square blocks, sorted."""
    found = sparse.bsr_array(rows, blocksize=(width, width))
    found.sort_indices()
    return found


def _with_single_parts(comm: Any, starts: Int, patches: Patches | None) -> Patches:
    """Patches of this rank, and its parts that are in no patch of any rank; empty ones are left out."""
    first, last = int(starts[comm.rank]), int(starts[comm.rank + 1])
    offsets, parts = (np.zeros(1, np.int64), _EMPTY) if patches is None else (patches.offsets, patches.parts)
    held = swapped(comm, by_owner(frozen_int(np.unique(parts)), starts)).values()
    alone = np.ones(last - first, bool)
    for each in held:
        alone[each - first] = False
    sizes, single = np.diff(offsets), first + np.flatnonzero(alone)
    sizes = np.concatenate((sizes[sizes > 0], np.ones(len(single), np.int64)))
    return Patches(starts_of(sizes), frozen_int(np.concatenate((parts, single))))


def _near_others(groups: Patches, own: Any, first: int, last: int) -> Mask:
    """Which patches have a part of another rank, or a neighbour there."""
    away = (own.indices < first) | (own.indices >= last)
    return _with_any(groups, _rows_with(own, away), first, last)


def _touches(groups: Patches, own: Any, parts: Int, first: int, last: int) -> Mask:
    """Which patches have one of some own parts, or a neighbour among them, or parts of other ranks."""
    marked = np.zeros(last - first + 1, bool)
    marked[parts] = True
    columns = np.clip(own.indices - first, -1, last - first)  # others are none of them
    return _with_any(groups, marked[:-1] | _rows_with(own, marked[columns]), first, last)


def _rows_with(own: Any, entries: Mask) -> Mask:
    """Own parts ``(n_own,)`` with at least one of some entries of a BSR."""
    found = np.zeros(len(own.indptr) - 1, bool)
    found[np.repeat(np.arange(len(found)), np.diff(own.indptr))[entries]] = True
    return found


def _with_any(groups: Patches, marked: Mask, first: int, last: int) -> Mask:
    """Which patches have a marked own part, or one of another rank."""
    inside = (groups.parts >= first) & (groups.parts < last)
    counts = np.ones(len(groups.parts), bool)
    counts[inside] = marked[groups.parts[inside] - first]
    group = np.repeat(np.arange(len(groups)), np.diff(groups.offsets))
    return np.asarray(np.bincount(group[counts], minlength=len(groups)) > 0)


def _chosen(groups: Patches, which: Mask) -> Patches:
    sizes = np.diff(groups.offsets)
    return Patches(starts_of(sizes[which]), frozen_int(groups.parts[np.repeat(which, sizes)]))


def _rows_seen(comm: Any, own: Any, starts: Int, changed: Int) -> tuple[list[tuple[Any, Any, Any]], Int]:
    """Rows of the changed parts of other ranks: counts, columns, blocks; parts of theirs in any such row."""
    first, last = int(starts[comm.rank]), int(starts[comm.rank + 1])
    asked = by_owner(changed, starts)
    mine = asked.pop(comm.rank, _EMPTY)
    answers = {rank: _taken(own, frozen_int(each - first)) for rank, each in swapped(comm, asked).items()}
    rows = list(swapped(comm, answers).values())
    columns = [each[1] for each in (_taken(own, frozen_int(mine - first)), *rows)]
    seen = np.unique(np.concatenate((changed, *columns)))
    return rows, frozen_int(seen[(seen < first) | (seen >= last)])


def _taken(rows: Any, which: Int) -> tuple[Any, Any, Any]:
    """Some rows of a BSR: counts, columns, blocks."""
    counts = np.diff(rows.indptr)[which]
    ends = np.cumsum(counts)
    total = int(ends[-1]) if len(ends) else 0
    at = np.repeat(rows.indptr[which] - ends + counts, counts) + np.arange(total)
    return counts, rows.indices[at], rows.data[at]


def _square(rows: tuple[Any, Int, Any], places: Int, n: int, width: int) -> Any:
    """Rows at their places in a square BSR whose others are empty."""
    counts, columns, blocks = rows
    order = np.argsort(places, kind="stable")
    sizes, ends = np.zeros(n, np.int64), np.cumsum(counts)
    sizes[places] = counts
    entries = np.repeat((ends - counts)[order] - starts_of(counts[order])[:-1], counts[order])
    entries += np.arange(len(entries))
    arrays = blocks[entries], columns[entries], np.array(starts_of(sizes))
    found = sparse.bsr_array(arrays, shape=(n * width, n * width))
    found.sort_indices()
    return found


def _tellers(
    comm: Any, starts: Int, changed: Int, copied: Mapping[int, Int]
) -> tuple[dict[int, Int], dict[int, Int]]:
    """Which of the parts that this rank changes others have, and which of its own and copies others change.

    The owner of a part knows who has copies, and tells those who change it.
    """
    first, count = int(starts[comm.rank]), int(starts[comm.rank + 1] - starts[comm.rank])
    writers = swapped(comm, by_owner(changed, starts))
    holders = dict(copied) | {comm.rank: np.arange(count)}
    has = {rank: np.isin(np.arange(count), each) for rank, each in holders.items()}
    answers: dict[int, dict[int, Any]] = {}
    for writer, parts in writers.items():
        shared = {rank: parts[each[parts - first]] for rank, each in has.items() if rank != writer}
        answers[writer] = {rank: each for rank, each in shared.items() if len(each)}
    pieces: dict[int, list[Int]] = {}
    for answer in swapped(comm, answers).values():
        for rank, parts in answer.items():
            pieces.setdefault(rank, []).append(parts)
    told = {rank: frozen_int(np.concatenate(pieces[rank])) for rank in sorted(pieces)}
    return told, swapped(comm, told)


def _colours(comm: Any, touched: list[int]) -> dict[int, int]:
    """Colour of each rank; of two of which one changes what the other has they differ."""
    beside: list[set[int]] = [set() for _ in range(comm.size)]
    for rank, others in enumerate(comm.allgather(touched)):
        for other in others:
            beside[rank].add(other)
            beside[other].add(rank)
    colours: dict[int, int] = {}
    for rank, others in enumerate(beside):
        taken = {colours[other] for other in others if other in colours}
        colours[rank] = next(colour for colour in range(comm.size + 1) if colour not in taken)
    return colours


def starts_of(sizes: Any) -> Int:
    """Where each of some lists begins when they come one after the other, and their end ``(n + 1,)``."""
    return frozen_int(np.concatenate(([0], np.cumsum(sizes))))
