"""Cells with their faces and points by global ids, as exchanged between ranks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.mesh.elements import gather


class WholeCells(NamedTuple):
    """Subset of the mesh cells with all their faces and points, each sorted by global id.

    A face on two ranks has equal number, sides and loop on both.
    """

    cells: Int  # (n,) global ids
    owners: Int  # (n,) ranks
    cell_tags: Mapping[str, Int]
    faces: Int  # (F,) global numbers, which order the faces of a cell
    face_offsets: Int  # (F + 1,)
    face_vertices: Int  # into points
    face_cells: Int  # (F, 2) global ids of owner and neighbour (here or not), -1 outside
    face_owners: Int  # (F, 2) ranks of these cells, -1 outside
    face_tags: Mapping[str, Int]
    points: Int  # (p,) global ids
    coordinates: Float  # (p, d)


def places(sought: Int, among: Int) -> Int:
    """Return the index of each sought number in the increasing array ``among (n,)``, or -1 if missing."""
    if not len(among):
        return frozen_int(np.full(np.shape(sought), -1))
    found = np.minimum(np.searchsorted(among, sought), len(among) - 1)
    return frozen_int(np.where(among[found] == sought, found, -1))


def distinct(values: NDArray[np.int64]) -> Int:
    """Return the distinct values in increasing order.

    Sorting is used because ``numpy.unique`` by hashing can take a hundred times as long.
    """
    ordered = np.sort(values, axis=None)
    new = np.ones(len(ordered), bool)
    new[1:] = ordered[1:] != ordered[:-1]
    return frozen_int(ordered[new])


def take_cells(whole: WholeCells, cells: Int, faces: Int) -> WholeCells:
    """Select cells and faces by their indices (increasing), with their points."""
    offsets, entries = gather(whole.face_offsets, faces)
    vertices = whole.face_vertices[entries]
    is_used = np.zeros(len(whole.points), bool)
    is_used[vertices] = True
    points = np.flatnonzero(is_used)
    number = np.empty(len(is_used), np.int64)
    number[points] = np.arange(len(points))
    return WholeCells(
        whole.cells[cells],
        whole.owners[cells],
        {name: values[cells] for name, values in whole.cell_tags.items()},
        whole.faces[faces],
        offsets,
        frozen_int(number[vertices]),
        whole.face_cells[faces],
        whole.face_owners[faces],
        {name: values[faces] for name, values in whole.face_tags.items()},
        whole.points[points],
        whole.coordinates[points],
    )


def merge_cells(parts: Sequence[WholeCells]) -> WholeCells:
    """Merge all parts' cells, faces and points, and keep the first of those with equal id."""
    if len(parts) == 1:
        return parts[0]
    # Merge the global numbers, keeping first occurrences.
    _, cells = _merge_numbers([part.cells for part in parts])
    _, faces = _merge_numbers([part.faces for part in parts])
    points, first = _merge_numbers([part.points for part in parts])
    # Faces and their vertices by the merged numbers.
    sizes = np.concatenate([np.diff(part.face_offsets) for part in parts])
    offsets, entries = gather(frozen_int(np.concatenate(([0], np.cumsum(sizes)))), faces)
    vertices = np.concatenate([places(part.points, points)[part.face_vertices] for part in parts])

    def column(name: str, rows: Int) -> NDArray[np.int64]:
        return np.concatenate([getattr(part, name) for part in parts])[rows]

    return WholeCells(
        frozen_int(column("cells", cells)),
        frozen_int(column("owners", cells)),
        _merge_tags([part.cell_tags for part in parts], cells),
        frozen_int(column("faces", faces)),
        offsets,
        frozen_int(vertices[entries]),
        frozen_int(column("face_cells", faces)),
        frozen_int(column("face_owners", faces)),
        _merge_tags([part.face_tags for part in parts], faces),
        points,
        frozen_float(np.concatenate([part.coordinates for part in parts])[first]),
    )


def _merge_numbers(numbers: Sequence[Int]) -> tuple[Int, Int]:
    """Return the distinct numbers of all arrays, increasing, and the index of their first occurrence."""
    different, first = np.unique(np.concatenate(numbers), return_index=True)
    return frozen_int(different), frozen_int(first)


def _merge_tags(parts: Sequence[Mapping[str, Int]], rows: Int) -> dict[str, Int]:
    return {name: frozen_int(np.concatenate([part[name] for part in parts])[rows]) for name in parts[0]}


def parcels(
    whole: WholeCells, cells: tuple[Int, Int], faces: tuple[Int, Int], always: Iterable[int] = ()
) -> dict[int, WholeCells]:
    """Return the cells and faces to send to each rank.

    Parameters
    ----------
    whole : WholeCells
    cells, faces : (ranks (k,), places (k,))
        Destination ranks and positions, possibly repeated.
    always : iterable of int
        Ranks that receive a parcel in any case, if only with tag names.
    """
    by_cell, by_face = _by_rank(*cells, len(whole.cells)), _by_rank(*faces, len(whole.faces))
    none = frozen_int([])
    return {
        rank: take_cells(whole, by_cell.get(rank, none), by_face.get(rank, none))
        for rank in sorted({*by_cell, *by_face, *always})
    }


def _by_rank(ranks: Int, where: Int, n: int) -> dict[int, Int]:
    """Group indices below n by destination rank, each listed once and increasing."""
    to, rows = np.divmod(distinct(ranks * n + where), max(n, 1))
    bounds = np.append(np.flatnonzero(np.diff(to, prepend=-1)), len(to)).tolist()
    return {int(to[i]): frozen_int(rows[i:j]) for i, j in pairwise(bounds)}
