"""Points that several ranks have, and whether numbers agree; one number for all points at one place."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_int, splitmix
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.meeting import Meeting, groups, rank_of_key, refuse_all


def check_ids(ids: Int, n: int, ranks: Ranks) -> None:
    """Raise MeshError on all ranks unless each of 0..n−1 is among the ``ids`` of just one rank, once.

    The numbers of ids on the ranks must add up to n.
    """
    wrong = np.flatnonzero((ids < 0) | (ids >= n))
    found = f"rank {ranks.rank}: cell id {ids[wrong[0]]}, but there are {n} cells" if len(wrong) else None
    refuse_all(ranks, found)
    meeting = Meeting(ranks, frozen_int(ids * ranks.size // n), ids)
    order, bounds = groups(meeting.columns[0])
    double = np.flatnonzero(np.diff(bounds) > 1)
    if len(double):
        rows = order[bounds[double[0]] : bounds[double[0] + 1]]
        of = ", ".join(str(rank) for rank in meeting.senders[rows])
        found = f"cell id {meeting.columns[0][rows[0]]} is given {len(rows)} times, on ranks {of}"
    refuse_all(ranks, found)


def shared_points(ids: Int, points: Float, ranks: Ranks) -> Mask:
    """Which of the points ``(n, d)`` of this rank, each listed once, others have too.

    Raises
    ------
    MeshError
        On all ranks, if points with the same global id are at different places.
    """
    to = rank_of_key(splitmix(ids.view(np.uint64)), ranks.size)
    meeting = Meeting(ranks, to, ids, points)
    known, where = meeting.columns
    order, bounds = groups(known)
    sizes = np.diff(bounds)
    first = np.empty(len(known), np.int64)
    first[order] = np.repeat(order[bounds[:-1]], sizes)
    moved = np.flatnonzero((where != where[first]).any(axis=1))
    found = None
    if len(moved):
        rows = (first[moved[0]], moved[0])
        places = " and ".join(f"at {where[row].tolist()} on rank {meeting.senders[row]}" for row in rows)
        found = f"point {known[rows[0]]} is {places}"
    refuse_all(ranks, found)
    shared = np.empty(len(known), bool)
    shared[order] = np.repeat(sizes > 1, sizes)
    return meeting.answered(shared)[0]


def numbered_by_place(points: Float, ranks: Ranks) -> Int:
    """Global ids ``(n,)`` of points ``(n, d)``: the same for those at exactly the same place on all ranks.

    The ids do not depend on how the points lie on the ranks.
    """
    points = points + 0.0  # -0.0 equals 0.0
    key = np.zeros(len(points), np.uint64)
    for column in np.ascontiguousarray(points).view(np.uint64).T:
        key = splitmix(key ^ column)
    meeting = Meeting(ranks, rank_of_key(key, ranks.size), points, key)
    where, keys = meeting.columns
    order, bounds = groups(*where.T, keys)
    before = sum(ranks.gathered(len(bounds) - 1)[: ranks.rank])
    number = np.empty(len(where), np.int64)
    number[order] = np.repeat(np.arange(len(bounds) - 1) + before, np.diff(bounds))
    return frozen_int(meeting.answered(number)[0])
