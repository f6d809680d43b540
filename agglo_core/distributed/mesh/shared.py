"""Points and faces shared by several ranks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, Mask, UInt64, frozen_int, splitmix
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.meeting import Meeting, groups, rank_of_key, refuse_all


def check_ids(ids: Int, n: int, ranks: Ranks) -> None:
    """Raise MeshError on all ranks unless the ``ids`` of all ranks form a permutation of 0..n−1.

    The number of ids must add up to n over the ranks.
    """
    wrong = np.flatnonzero((ids < 0) | (ids >= n))
    fault = f"rank {ranks.rank}: cell id {ids[wrong[0]]}, but there are {n} cells" if len(wrong) else None
    refuse_all(ranks, fault)
    # Collect equal ids on one rank and look for duplicates.
    meeting = Meeting(ranks, frozen_int(ids * ranks.size // n), ids)
    order, bounds = groups(meeting.columns[0])
    double = np.flatnonzero(np.diff(bounds) > 1)
    if len(double):
        rows = order[bounds[double[0]] : bounds[double[0] + 1]]
        of = ", ".join(str(rank) for rank in meeting.senders[rows])
        fault = f"cell id {meeting.columns[0][rows[0]]} is given {len(rows)} times, on ranks {of}"
    refuse_all(ranks, fault)


def mark_shared_points(ids: Int, points: Float, ranks: Ranks) -> Mask:
    """Mark the points ``(n, d)`` of this rank (all distinct) that also belong to other ranks.

    Raises
    ------
    MeshError
        On all ranks, if points with equal global id have different coordinates.
    """
    # Collect points with equal id on one rank and compare their coordinates.
    to = rank_of_key(splitmix(ids.view(np.uint64)), ranks.size)
    meeting = Meeting(ranks, to, ids, points)
    meeting_ids, coords = meeting.columns
    order, bounds = groups(meeting_ids)
    sizes = np.diff(bounds)
    first = np.empty(len(meeting_ids), np.int64)
    first[order] = np.repeat(order[bounds[:-1]], sizes)
    differing = np.flatnonzero((coords != coords[first]).any(axis=1))
    fault = None
    if len(differing):
        rows = (first[differing[0]], differing[0])
        places = " and ".join(f"at {coords[row].tolist()} on rank {meeting.senders[row]}" for row in rows)
        fault = f"point {meeting_ids[rows[0]]} is {places}"
    refuse_all(ranks, fault)
    shared = np.empty(len(meeting_ids), bool)
    shared[order] = np.repeat(sizes > 1, sizes)
    return meeting.answered(shared)[0]


def number_by_place(points: Float, ranks: Ranks) -> Int:
    """Number points ``(n, d)`` globally, with equal ids ``(n,)`` for exactly equal coordinates.

    The ids do not depend on how points are distributed over the ranks.
    """
    points = points + 0.0  # -0.0 equals 0.0
    key = np.zeros(len(points), np.uint64)
    for column in np.ascontiguousarray(points).view(np.uint64).T:
        key = splitmix(key ^ column)
    meeting = Meeting(ranks, rank_of_key(key, ranks.size), points, key)
    coords, keys = meeting.columns
    order, bounds = groups(*coords.T, keys)
    before = sum(ranks.gathered(len(bounds) - 1)[: ranks.rank])
    number = np.empty(len(coords), np.int64)
    number[order] = np.repeat(np.arange(len(bounds) - 1) + before, np.diff(bounds))
    return frozen_int(meeting.answered(number)[0])


class FaceKeys(NamedTuple):
    """Hash keys of faces ``(n,)``, equal for faces with equal points in any order."""

    low: Int  # the smallest point
    mixed: UInt64  # sum of the hashes of all points


class Beyond(NamedTuple):
    """Cell, rank and face number on the other side of each face ``(n,)`` between ranks, -1 for others."""

    cells: Int
    ranks: Int
    faces: Int  # face number on the other rank
    tags: NDArray[np.int64]  # (n, k) tags of the face on the other rank


def face_keys(vertices: Int, offsets: Int) -> FaceKeys:
    """Return hash keys of faces with global points ``vertices[offsets[f]:offsets[f + 1]]``."""
    if len(offsets) < 2:
        return FaceKeys(frozen_int([]), np.empty(0, np.uint64))
    mixed = np.add.reduceat(splitmix(vertices.view(np.uint64)), offsets[:-1])
    return FaceKeys(frozen_int(np.minimum.reduceat(vertices, offsets[:-1])), mixed)


def cells_beyond(
    vertices: Int, offsets: Int, cells: Int, tags: NDArray[np.int64], numbers: Int, ranks: Ranks
) -> Beyond:
    """Find the cell on the other side of each face ``(n,)``, if it belongs to another rank.

    The faces must include all faces between ranks.

    Parameters
    ----------
    vertices, offsets : CSR
        Global points per face in the owner's orientation.
    cells : (n, 2) int
        Global own cell ids on both sides, -1 for none.
    tags : (n, k) int
        Face tags, 0 for no tag.
    numbers : (n,) int
        Face numbers to pass to other ranks.

    Raises
    ------
    MeshError
        On all ranks, with cells and ranks: for a face with three cells, two cells on one side of a face,
        or ranks with different face tags.
    """
    # Collect the sides of each face on one rank and pair them.
    low, mixed = face_keys(vertices, offsets)
    to = rank_of_key(splitmix(low.view(np.uint64)), ranks.size)
    meeting = Meeting(ranks, to, low, mixed, cells, _turns(vertices, offsets, low), numbers, tags)
    low, mixed, sides, turn, number, side_tags = meeting.columns
    order, bounds = groups(mixed, low)
    single = np.flatnonzero(np.diff(bounds) == 2)
    a, b = order[bounds[single]], order[bounds[single] + 1]
    refuse_all(ranks, _third_cell(sides[order], bounds, meeting.senders[order]))
    # Refuse faces with more than two cells, with both cells on one side, or with contradictory tags.
    overlap = turn[a] == turn[b]
    differ = ((side_tags[a] != side_tags[b]) & (side_tags[a] != 0) & (side_tags[b] != 0)).any(axis=1)
    for wrong, complaint in (
        (overlap, "lie on the same side of a face"),
        (differ, "have different tags on their common face"),
    ):
        fault = None
        if wrong.any():
            pair = [(a if first else b)[np.argmax(wrong)] for first in (True, False)]
            cell = [f"cell {sides[row, 0]} (rank {meeting.senders[row]})" for row in pair]
            fault = f"{cell[0]} and {cell[1]} {complaint}"
        refuse_all(ranks, fault)
    # Reply to each side with cell, rank, number and tags of its partner.
    partner = np.full(len(order), -1)
    partner[a], partner[b] = b, a
    none = partner < 0
    columns = [np.where(none, -1, column[partner]) for column in (sides[:, 0], meeting.senders, number)]
    return Beyond(*meeting.answered(*columns, np.where(none[:, None], 0, side_tags[partner])))


def _turns(vertices: Int, offsets: Int, low: Int) -> Int:
    """Return the successor of the smallest point id in each face loop, which shows the orientation.

    For an edge, return its first point.
    """
    sizes = np.diff(offsets)
    at = np.flatnonzero(vertices == np.repeat(low, sizes))  # no loop meets a point twice
    following = np.where(at + 1 < offsets[1:], at + 1, offsets[:-1])
    return frozen_int(vertices[np.where(sizes == 2, offsets[:-1], following)])


def _third_cell(sides: Int, bounds: Int, senders: Int) -> str | None:
    """Describe the first face with more than two cells, or return None if there is no such face."""
    count = np.diff(np.append(0, np.cumsum((sides >= 0).sum(axis=1)))[bounds])
    crowded = np.flatnonzero(count > 2)
    if not len(crowded):
        return None
    rows = range(bounds[crowded[0]], bounds[crowded[0] + 1])
    cells = [f"{cell} (rank {senders[row]})" for row in rows for cell in sides[row] if cell >= 0]
    return f"a face has more than two cells: cells {', '.join(cells)}"
