"""Points and faces that several ranks share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, Mask, UInt64, frozen_int, splitmix
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


class FaceKeys(NamedTuple):
    """What tells faces ``(n,)`` apart: equal for those with the same points, in whatever order these come."""

    low: Int  # the smallest point
    mixed: UInt64  # sum of well-mixed numbers of all


class Beyond(NamedTuple):
    """The other side of each face ``(n,)``, where that is on another rank; else -1."""

    cells: Int
    ranks: Int
    faces: Int  # number of the face there
    tags: NDArray[np.int64]  # (n, k) what is said of the face there


def face_keys(vertices: Int, offsets: Int) -> FaceKeys:
    """Keys of faces with global points ``vertices[offsets[f]:offsets[f + 1]]``."""
    if len(offsets) < 2:
        return FaceKeys(frozen_int([]), np.empty(0, np.uint64))
    mixed = np.add.reduceat(splitmix(vertices.view(np.uint64)), offsets[:-1])
    return FaceKeys(frozen_int(np.minimum.reduceat(vertices, offsets[:-1])), mixed)


def cells_beyond(
    vertices: Int, offsets: Int, cells: Int, tags: NDArray[np.int64], numbers: Int, ranks: Ranks
) -> Beyond:
    """The cells of other ranks at faces ``(n,)`` of this one, which may be all whose points others have too.

    Parameters
    ----------
    vertices, offsets : CSR
        Global points of each face, as the owner sees them.
    cells : (n, 2) int
        Global ids of the own cells on both sides; -1 where there is none.
    tags : (n, k) int
        0 is for no tag.
    numbers : (n,) int
        By which others are to know the faces.

    Raises
    ------
    MeshError
        On all ranks, naming cells and ranks: if a face has three cells, if two are on the same side of it, if
        the tags of both ranks differ.
    """
    low, mixed = face_keys(vertices, offsets)
    to = rank_of_key(splitmix(low.view(np.uint64)), ranks.size)
    meeting = Meeting(ranks, to, low, mixed, cells, _turns(vertices, offsets, low), numbers, tags)
    low, mixed, sides, turn, number, said = meeting.columns
    order, bounds = groups(mixed, low)
    single = np.flatnonzero(np.diff(bounds) == 2)
    a, b = order[bounds[single]], order[bounds[single] + 1]
    refuse_all(ranks, _third_cell(sides[order], bounds, meeting.senders[order]))
    overlap = turn[a] == turn[b]
    differ = ((said[a] != said[b]) & (said[a] != 0) & (said[b] != 0)).any(axis=1)
    for wrong, what in (
        (overlap, "lie on the same side of a face"),
        (differ, "differ in a tag of their face"),
    ):
        named = None
        if wrong.any():
            pair = [(a if first else b)[np.argmax(wrong)] for first in (True, False)]
            cell = [f"cell {sides[row, 0]} (rank {meeting.senders[row]})" for row in pair]
            named = f"{cell[0]} and {cell[1]} {what}"
        refuse_all(ranks, named)
    partner = np.full(len(order), -1)
    partner[a], partner[b] = b, a
    none = partner < 0
    found = [np.where(none, -1, each[partner]) for each in (sides[:, 0], meeting.senders, number)]
    return Beyond(*meeting.answered(*found, np.where(none[:, None], 0, said[partner])))


def _turns(vertices: Int, offsets: Int, low: Int) -> Int:
    """Where each loop goes from its smallest point, an edge from its tail: differs on the two sides."""
    sizes = np.diff(offsets)
    at = np.flatnonzero(vertices == np.repeat(low, sizes))  # no loop meets a point twice
    following = np.where(at + 1 < offsets[1:], at + 1, offsets[:-1])
    return frozen_int(vertices[np.where(sizes == 2, offsets[:-1], following)])


def _third_cell(sides: Int, bounds: Int, senders: Int) -> str | None:
    """What is wrong with the first face that has three cells."""
    count = np.diff(np.append(0, np.cumsum((sides >= 0).sum(axis=1)))[bounds])
    many = np.flatnonzero(count > 2)
    if not len(many):
        return None
    rows = range(bounds[many[0]], bounds[many[0] + 1])
    cells = [f"{cell} (rank {senders[row]})" for row in rows for cell in sides[row] if cell >= 0]
    return f"a face has more than two cells: cells {', '.join(cells)}"
