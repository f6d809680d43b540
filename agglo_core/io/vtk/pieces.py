"""Convert the arrays of VTK pieces (UnstructuredGrid or PolyData) to cells, and the cells to a mesh."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Protocol, Unpack

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.tags import BRIDGES, note_left_out
from agglo_core.io.to_mesh.options import ReadOptions
from agglo_core.io.to_mesh.soup import Soup, mesh_from_soup, record_repairs
from agglo_core.io.vtk.joined_pieces import drop_ghosts, in_global_order, join_pieces
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import Polyhedra, concatenate, gather

KINDS = ("Verts", "Lines", "Polys", "Strips")
"""Cell types of PolyData in VTK's numbering order."""

_TYPES = {"Verts": 2, "Lines": 4, "Polys": 7, "Strips": 6}
_LINE, _POLYLINE, _POLYHEDRON = 3, 4, 42
_WITH_BRIDGES = (5, 7, 9)  # types of 2-D cells that agglo writes
# Bounds that only damaged or forged files exceed: number of cells per point, and number of visits of one cell
# to a point (including bridges and pinches).
_VISITS = 32
_FEW = 1 << 15  # pieces with fewer points may have as many cells as a piece of this size


class StoredArrays(dict[str, Int]):
    """Integer arrays of a VTK piece by name, held in memory."""

    def take(self, name: str, declared: int) -> Int:
        """Return the array with this name."""
        return self[name]


def polydata_cells(lists: Mapping[str, tuple[Int, Int]]) -> StoredArrays:
    """Convert the cells of a PolyData piece to the arrays of an UnstructuredGrid piece.

    Parameters
    ----------
    lists : mapping of kind to (ends, points)
        For each available type in :data:`KINDS`, the end of each cell's points, and the points.
    """
    types, offsets, points = [], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for kind in KINDS:
        ends, vertices = lists.get(kind, (frozen_int([]), frozen_int([])))
        sizes = np.diff(ends, prepend=0)
        line_types = np.full(len(ends), _TYPES[kind])
        types.append(np.where((line_types == _POLYLINE) & (sizes == 2), _LINE, line_types))
        offsets.append(ends + sum(map(len, points)))
        points.append(vertices)
    return StoredArrays(
        types=frozen_int(np.concatenate(types)),
        offsets=frozen_int(np.concatenate(offsets)),
        connectivity=frozen_int(np.concatenate(points)),
    )


class CellArrays(Protocol):
    """Interface to the integer arrays of a VTK piece, under their names in VTU files."""

    def __contains__(self, name: str) -> bool:
        """Return True if the piece has an array with this name."""

    def take(self, name: str, declared: int) -> Int:
        """Return the array with this name, of the declared length.

        Raises FileError if damaged.
        """


class Stored(NamedTuple):
    """Pieces of a mesh as read from a VTK file, and names of skipped data.

    Attributes
    ----------
    pieces : list of Soup
    left_out : list of str
        Names of cell data that are no tags, one entry per piece.
    ours : bool
        True if agglo wrote the file; global ids are then those of the mesh.
    """

    pieces: list[Soup]
    left_out: list[str]
    ours: bool = False


def check_counts(n_points: int, n: int) -> None:
    """Raise FileError if a piece has implausibly many cells for its point count."""
    if n > _VISITS * max(n_points, _FEW):
        raise FileError(f"a Piece of {n} cells has only {n_points} points")


def soup_of_piece(arrays: CellArrays, points: Float, n: int) -> Soup:
    """Convert the arrays of a VTK piece to a list of n cells, without tags.

    Raises FileError if damaged.
    """
    n_points = len(points)
    if n == 0:
        none = frozen_int(np.empty(0))
        return Soup(points, none, frozen_int([0]), none, concatenate([]), {})
    visits = _VISITS * n * n_points
    types, ends = arrays.take("types", n), arrays.take("offsets", n)
    if len(types) != n or len(ends) != n:
        raise FileError(f"a Piece of {n} cells has {len(types)} types and {len(ends)} offsets")
    vertices = arrays.take("connectivity", min(int(ends[-1]), visits))
    offsets = _offsets(ends, len(vertices), "offsets")
    if vertices.size and not (vertices.min() >= 0 and vertices.max() < n_points):
        raise FileError(f"array 'connectivity' uses points outside 0..{n_points - 1}")
    solids = _polyhedra(arrays, np.flatnonzero(types == _POLYHEDRON), n, visits)
    if solids.vertices.size and not (solids.vertices.min() >= 0 and solids.vertices.max() < n_points):
        raise FileError(f"faces of polyhedra use points outside 0..{n_points - 1}")
    return Soup(points, types, offsets, vertices, solids, {})


def _offsets(ends: Int, size: int, name: str) -> Int:
    offsets = np.concatenate(([0], ends))
    if (np.diff(offsets) < 0).any() or offsets[-1] != size:
        raise FileError(f"array {name!r} must increase to {size}, but it ends at {offsets[-1]}")
    return frozen_int(offsets)


def _polyhedra(arrays: CellArrays, solids: Int, n: int, visits: int) -> Polyhedra:
    """Return the faces of those among n cells that are polyhedra, given by their indices ``solids``.

    Array lengths are bounded by ``visits``.
    """
    if not len(solids):
        return concatenate([])
    if "polyhedron_to_faces" not in arrays:
        stops = arrays.take("faceoffsets", n)
        if len(stops) != n:
            raise FileError(f"array 'faceoffsets' has {len(stops)} values for {n} cells")
        return _face_stream(arrays.take("faces", min(int(stops.max()), visits)), frozen_int(stops[solids]))
    # New layout: polyhedra refer to faces, faces to points.
    ends = arrays.take("polyhedron_offsets", n)
    if len(ends) != n:
        raise FileError(f"array 'polyhedron_offsets' has {len(ends)} values for {n} cells")
    faces = arrays.take("polyhedron_to_faces", min(int(ends[-1]), visits))
    stops = arrays.take("face_offsets", len(faces))
    loops = arrays.take("face_connectivity", min(int(stops.max(initial=0)), visits))
    loop_offsets = _offsets(stops, len(loops), "face_offsets")
    offsets, places = gather(_offsets(ends, len(faces), "polyhedron_offsets"), solids)
    if faces.size and not (faces.min() >= 0 and faces.max() < len(loop_offsets) - 1):
        raise FileError(f"array 'polyhedron_to_faces' uses faces outside 0..{len(loop_offsets) - 2}")
    loop_offsets, entries = gather(loop_offsets, faces[places])
    return Polyhedra(offsets, loop_offsets, frozen_int(loops[entries]))


def _face_stream(stream: Int, stops: Int) -> Polyhedra:
    """Decode the faces ``n_faces, size, v…, size, v…`` of consecutive polyhedra, which end at ``stops[c]``.

    The loop runs over face ranks and handles all cells at once.
    """
    starts = np.concatenate(([0], stops[:-1]))
    if (starts >= stops).any() or starts[0] < 0 or stops[-1] > len(stream):
        raise FileError("array 'faceoffsets' must increase and stay within 'faces'")
    counts = stream[starts]
    if (counts < 1).any() or (counts > stops - starts).any():
        raise FileError("array 'faces': a cell declares more faces than it holds, or none")
    offsets = np.concatenate(([0], np.cumsum(counts)))
    sizes, places = np.empty(offsets[-1], np.int64), np.empty(offsets[-1], np.int64)
    cursor, cells = starts + 1, np.arange(len(stops))
    for rank in range(int(counts.max())):
        cells = cells[counts[cells] > rank]
        if (cursor[cells] >= stops[cells]).any():
            raise FileError("array 'faces' ends before the last face of a cell")
        size = stream[cursor[cells]]
        if (size < 1).any() or (cursor[cells] + size >= stops[cells]).any():
            raise FileError("array 'faces' has an empty face, or one longer than its cell")
        sizes[offsets[cells] + rank], places[offsets[cells] + rank] = size, cursor[cells] + 1
        cursor[cells] += size + 1
    loop_offsets = np.concatenate(([0], np.cumsum(sizes)))
    entries = np.arange(loop_offsets[-1]) + np.repeat(places - loop_offsets[:-1], sizes)
    return Polyhedra(frozen_int(offsets), frozen_int(loop_offsets), frozen_int(stream[entries]))


def mesh_from_pieces(stored: Stored, *, name: str, **options: Unpack[ReadOptions]) -> Mesh:
    """Build a mesh from the pieces in a VTK file, without ghost cells.

    Raises an AggloError.
    """
    soup, ghosts = soup_of_pieces(stored.pieces)
    soup, left_out = in_global_order(soup) if stored.ours else soup, stored.left_out
    return mesh_of_soup(soup, ghosts, left_out, name=name, **options)


def soup_of_pieces(pieces: Sequence[Soup]) -> tuple[Soup, int]:
    """Concatenate the cells of all pieces, without ghost cells.

    Return them and the number of dropped ghosts. Raises FileError.
    """
    pairs = [drop_ghosts(piece) for piece in pieces]
    return join_pieces([piece for piece, _ in pairs]), sum(count for _, count in pairs)


def mesh_of_soup(
    soup: Soup, ghosts: int, left_out: Iterable[str], *, name: str, **options: Unpack[ReadOptions]
) -> Mesh:
    """Build a mesh from the joined cells of all pieces, and record the ghost cells and data left out.

    Repairs count dropped ghosts and cell data. Raises an AggloError.
    """
    weak = BRIDGES in soup.tags and bool(np.isin(soup.types, _WITH_BRIDGES).all())
    if weak:
        soup = soup._replace(tags={key: values for key, values in soup.tags.items() if key != BRIDGES})
    mesh = mesh_from_soup(soup, weak=weak, name=name, **options)
    mesh = record_repairs(mesh, {"ghost cells dropped": ghosts})
    return note_left_out(mesh, left_out)
