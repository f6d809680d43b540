"""Join the pieces of a distributed mesh: drop ghost cells, concatenate, sort by global numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.tags import GHOSTS
from agglo_core.io.to_mesh.listed_faces import join_listed_faces
from agglo_core.io.to_mesh.soup import Soup
from agglo_core.mesh.elements import concatenate, gather, take_cells

_GHOST = 1 | 32  # vtkGhostType bits: the cell belongs to another piece; the cell is hidden
_SOLID = 42


def drop_ghosts(soup: Soup) -> tuple[Soup, int]:
    """Remove the ghost cells of a piece (copies of cells in other pieces), and count them."""
    tags = dict(soup.tags)
    ghost = tags.pop(GHOSTS, frozen_int(np.zeros(len(soup.types)))) & _GHOST != 0
    soup = soup._replace(tags=tags)
    return (_pick_cells(soup, frozen_int(np.flatnonzero(~ghost))) if ghost.any() else soup), int(ghost.sum())


def _pick_cells(soup: Soup, cells: Int) -> Soup:
    """Return the cells with the given indices, in this order.

    Listed faces are kept only with all cells.
    """
    offsets, places = gather(soup.offsets, cells)
    solid = soup.types == _SOLID
    number = np.cumsum(solid) - 1  # rank among the polyhedra
    listed = soup.listed
    if listed is not None and len(cells) < len(soup.types):
        listed = None
    elif listed is not None:
        place = np.empty(len(cells), np.int64)
        place[cells] = np.arange(len(cells))
        listed = listed._replace(cells=frozen_int(place[listed.cells]))
    return soup._replace(
        types=frozen_int(soup.types[cells]),
        offsets=offsets,
        vertices=frozen_int(soup.vertices[places]),
        solids=take_cells(soup.solids, frozen_int(number[cells[solid[cells]]])),
        tags={key: frozen_int(values[cells]) for key, values in soup.tags.items()},
        listed=listed,
        cell_ids=None if soup.cell_ids is None else frozen_int(soup.cell_ids[cells]),
    )


def join_pieces(pieces: Sequence[Soup]) -> Soup:
    """Concatenate the cells, points and tags of all pieces.

    Tags missing in some piece are dropped.
    """
    if not pieces:
        raise FileError("it has no element Piece")
    pieces = [piece for piece in pieces if len(piece.types)] or pieces[:1]
    if len(pieces) == 1:
        return pieces[0]
    # Offsets of points, cells and vertices.
    shift = np.cumsum([0, *(len(piece.points) for piece in pieces)])[:-1]
    cells = np.cumsum([0, *(len(piece.types) for piece in pieces)])[:-1]
    ends = np.cumsum([0, *(len(piece.vertices) for piece in pieces)])[:-1]
    common = [key for key in pieces[0].tags if all(key in piece.tags for piece in pieces)]
    solids = [
        piece.solids._replace(vertices=frozen_int(piece.solids.vertices + start))
        for piece, start in zip(pieces, shift, strict=True)
    ]
    return Soup(
        frozen_float(np.concatenate([piece.points for piece in pieces])),
        frozen_int(np.concatenate([piece.types for piece in pieces])),
        frozen_int(np.concatenate([[0], *(p.offsets[1:] + e for p, e in zip(pieces, ends, strict=True))])),
        frozen_int(np.concatenate([p.vertices + s for p, s in zip(pieces, shift, strict=True)])),
        concatenate(solids),
        {key: frozen_int(np.concatenate([piece.tags[key] for piece in pieces])) for key in common},
        join_listed_faces([piece.listed for piece in pieces], cells, shift),
        _concatenate_if_all([piece.point_ids for piece in pieces]),
        _concatenate_if_all([piece.cell_ids for piece in pieces]),
    )


def _concatenate_if_all(arrays: Sequence[Int | None]) -> Int | None:
    present = [array for array in arrays if array is not None]
    return frozen_int(np.concatenate(present)) if len(present) == len(arrays) else None


def in_global_order(soup: Soup) -> Soup:
    """Sort cells by their global numbers, and merge points with equal global numbers.

    Raises FileError for contradictory ids.

    Cells and points without ids are unchanged.
    """
    if soup.point_ids is not None:
        soup = _merge_points(soup, soup.point_ids)
    if soup.cell_ids is None:
        return soup
    order = np.argsort(soup.cell_ids, kind="stable")
    ids = soup.cell_ids[order]
    repeats = np.flatnonzero(ids[1:] == ids[:-1])
    if len(repeats):
        raise FileError(f"GlobalCellIds: cell {ids[repeats[0]]} is in several pieces")
    return _pick_cells(soup, frozen_int(order))


def _merge_points(soup: Soup, point_ids: Int) -> Soup:
    """Merge all points with the same global number.

    Raises FileError if its coordinates differ.
    """
    ids, first, number = np.unique(point_ids, return_index=True, return_inverse=True)
    points = frozen_float(soup.points[first])
    elsewhere = np.flatnonzero(_differ(points[number], soup.points))
    if len(elsewhere):
        raise FileError(f"GlobalPointIds: point {point_ids[elsewhere[0]]} has several positions")
    solids, listed = soup.solids, soup.listed
    return soup._replace(
        points=points,
        vertices=frozen_int(number[soup.vertices]),
        solids=solids._replace(vertices=frozen_int(number[solids.vertices])),
        listed=None if listed is None else listed._replace(vertices=frozen_int(number[listed.vertices])),
        point_ids=frozen_int(ids),
    )


def _differ(p: Float, q: Float) -> Mask:
    """Return a mask ``(n,)`` of the rows in which two arrays of points differ.

    Non-finite points are reported elsewhere.
    """
    return np.asarray(((p != q) & ~(np.isnan(p) & np.isnan(q))).any(axis=1))
