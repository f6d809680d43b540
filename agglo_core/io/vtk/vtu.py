"""Read and write VTU and VTP (VTK's XML files): all encodings, several pieces, both polyhedron layouts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int, narrow
from agglo_core.errors import FileError
from agglo_core.io.levels import LevelValues
from agglo_core.io.tags import tag_values
from agglo_core.io.to_mesh.listed_faces import ListedFaces, parse_listed_faces
from agglo_core.io.to_mesh.options import Compressing, Reading
from agglo_core.io.to_mesh.soup import Soup
from agglo_core.io.vtk.cells import POLYHEDRON, Cells
from agglo_core.io.vtk.grids import Storage, renumber_vertices, write_grids
from agglo_core.io.vtk.pieces import (
    KINDS,
    CellArrays,
    Stored,
    check_counts,
    mesh_from_pieces,
    polydata_cells,
    soup_of_piece,
)
from agglo_core.io.vtk.xml_read import TYPES, Document, is_derived, parse
from agglo_core.io.vtk.xml_write import MESH, SOLUTION, write_document
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import take_cells
from agglo_core.progress import Notify, ignore_progress

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_FACES = 64  # face entries per cell above which an array is checked before it is decoded


class Vtu(Compressing):
    """VTU files, read and written without VTK: any mesh with its cell tags and level labels.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Keep coincident outer faces.
    compress : bool
        Compress the arrays with zlib: smaller files, slower to write and to read.
    drop_flat : bool
        Drop cells with zero area or volume.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.io import Vtu
    >>> Vtu().write(Path("mesh.vtu"), agglo.samples.squares(2))
    >>> Vtu().read(Path("mesh.vtu")).n_cells
    4
    """

    lossless: bool = False
    atomic: bool = True
    reports_progress: bool = True
    keeps_level_values: bool = True

    def read(self, path: Path) -> Mesh:
        """Read a VTU file.

        Pieces are joined, integer cell data become cell tags.

        Raises
        ------
        FileError, MeshError
            For a broken file or mesh.
        """
        return mesh_from_pieces(read_pieces(path.read_bytes()), **self.reading, name=path.stem)

    def write(
        self,
        path: Path,
        mesh: Mesh,
        hierarchy: Hierarchy | None = None,
        level_values: LevelValues | None = None,
        notify: Notify = ignore_progress,
    ) -> None:
        """Write the mesh, and each coarse mesh with its level values to a separate file.

        Raises an AggloError.
        """
        storage = Storage(write_document, face_stream, is_own_file)
        write_grids(storage, path, mesh, hierarchy, level_values, notify, compress=self.compress)


class Vtp(Reading):
    """VTP files (PolyData): polygons and triangle strips.

    The coordinate z must be constant (2-D); surfaces are rejected.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read the polygons and strips of a VTP file.

        Raises as :meth:`Vtu.read`.
        """
        return mesh_from_pieces(read_pieces(path.read_bytes(), "PolyData"), **self.reading, name=path.stem)


def read_pieces(content: bytes, kind: str = "UnstructuredGrid") -> Stored:
    """Read all pieces in the content of a VTK XML file of type ``kind``.

    Raises FileError if damaged.
    """
    document = parse(content, kind)
    grid = document.root.find(kind)
    if grid is None:
        return Stored([], [])
    _check_places(grid.iterfind(".//DataArray"))
    data = grid.iterfind("Piece/CellData/DataArray")
    skipped_names = [array.get("Name", "") for array in data if not _is_tag(array) and not is_derived(array)]
    pieces = [_piece(document, piece) for piece in grid.findall("Piece")]
    is_agglo_file = document.root.get("agglo") == "mesh"
    if len(pieces) == 1 and is_agglo_file:  # files of other programs may contain outdated lists
        pieces = [pieces[0]._replace(listed=_read_listed_faces(document, grid, pieces[0]))]
    return Stored(pieces, skipped_names, is_agglo_file)


def _read_listed_faces(document: Document, grid: ElementTree.Element, piece: Soup) -> ListedFaces | None:
    """Read the tagged faces that agglo stores as field data, or None if there are none."""
    n, elements = len(piece.types), grid.findall("FieldData/DataArray")
    fields = {element.get("Name", ""): document.array(element, _FACES * n) for element in elements}
    return parse_listed_faces(fields, len(piece.points), n)


def _check_places(elements: Iterable[ElementTree.Element]) -> None:
    """Reject files in which several arrays share bytes, because small files could then expand greatly."""
    names: dict[int, str] = {}
    for element in elements:
        if element.get("format") != "appended":
            continue
        name = element.get("Name", "Points")
        try:
            place = int(element.get("offset", ""))
        except ValueError:  # reported when the array is read
            continue
        if place in names:
            raise FileError(f"arrays {names[place]!r} and {name!r} begin at the same appended byte, {place}")
        names[place] = name


def _piece(document: Document, piece: ElementTree.Element) -> Soup:
    """Read the cells of one piece with their points, tags and global numbers.

    Raises FileError if damaged.
    """
    kinds = [kind for kind in KINDS if piece.find(kind) is not None]
    names = ["Points", *(kinds or ["Cells"])]
    try:
        n_points, *counts = (int(piece.get(f"NumberOf{name}", "")) for name in names)
    except ValueError:
        raise FileError(f"a Piece has no valid {' and '.join(f'NumberOf{name}' for name in names)}") from None
    n = sum(counts)
    check_counts(n_points, n)
    points = _points(document, piece, n_points)
    arrays: CellArrays = _Arrays(document, piece, "Cells")
    if kinds:
        lists = {kind: _list(document, piece, kind, k) for kind, k in zip(kinds, counts, strict=True) if k}
        arrays = polydata_cells(lists)
    soup = soup_of_piece(arrays, points, n)
    point_ids = _ids(document, piece.find("PointData"), n_points)
    cell_ids = _ids(document, piece.find("CellData"), n)
    return soup._replace(tags=_tags(document, piece, n) if n else {}, point_ids=point_ids, cell_ids=cell_ids)


def _list(document: Document, piece: ElementTree.Element, kind: str, n: int) -> tuple[Int, Int]:
    """Read n cells of one PolyData kind: the end of each cell's points, and the points."""
    arrays = _Arrays(document, piece, kind)
    ends = arrays.take("offsets", n)
    if len(ends) != n or (np.diff(ends, prepend=0) < 0).any():
        raise FileError(f"array 'offsets' of {kind} must increase and have {n} values")
    vertices = arrays.take("connectivity", int(ends[-1]))
    if len(vertices) != ends[-1]:
        raise FileError(f"array 'connectivity' of {kind} has {len(vertices)} values, expected {ends[-1]}")
    return ends, vertices


def _ids(document: Document, section: ElementTree.Element | None, n: int) -> Int | None:
    """Return the n global numbers of points or cells, or None if the file declares none."""
    name = "" if section is None else section.get("GlobalIds", "")
    for element in () if section is None or not name else section.iterfind("DataArray"):
        if element.get("Name") != name or not element.get("type", "").startswith(("Int", "UInt")):
            continue
        values = document.array(element, n)
        if len(values) != n:
            raise FileError(f"there are {len(values)} global ids {name!r}, expected {n}")
        return tag_values(name, values)
    return None


def _points(document: Document, piece: ElementTree.Element, n: int) -> Float:
    """Return the points ``(n, 3)`` of a piece.

    Raises FileError for another number.
    """
    element = piece.find("Points/DataArray")
    values = document.array(element, 3 * n) if element is not None else np.empty(0)
    if values.size != 3 * n:
        raise FileError(f"a Piece of {n} points has {values.size} coordinates, expected {3 * n}")
    return frozen_float(values.reshape(-1, 3))


def _tags(document: Document, piece: ElementTree.Element, n: int) -> dict[str, Int]:
    """Return as tags the integer cell data with one component, without data that agglo has computed."""
    tags = {}
    for element in piece.iterfind("CellData/DataArray"):
        if not _is_tag(element):
            continue
        name, values = element.get("Name", ""), document.array(element, n)
        if len(values) != n:
            raise FileError(f"cell data {name!r} has {len(values)} values for {n} cells")
        tags[name] = tag_values(name, values)
    return tags


def _is_tag(element: ElementTree.Element) -> bool:
    """Return True for a named integer array with one component, unless agglo has computed it."""
    if is_derived(element):
        return False
    kind = element.get("type", "")
    single = element.get("NumberOfComponents", "1").strip() in ("0", "1")
    return bool(element.get("Name")) and kind.startswith(("Int", "UInt")) and kind in TYPES and single


@dataclass(frozen=True)
class _Arrays:
    """Integer arrays in one XML section of a piece, decoded on request."""

    document: Document
    piece: ElementTree.Element
    section: str

    @cached_property
    def _elements(self) -> dict[str, ElementTree.Element]:
        return {
            element.get("Name", ""): element for element in self.piece.iterfind(f"{self.section}/DataArray")
        }

    def __contains__(self, name: str) -> bool:
        return name in self._elements

    def take(self, name: str, declared: int) -> Int:
        """Return the integer array with this name, for which the file declares ``declared`` values."""
        if name not in self._elements:
            names = ", ".join(self._elements) or "none"
            raise FileError(f"array {name!r} is missing from {self.section}; found {names}")
        values: NDArray[Any] = self.document.array(self._elements[name], declared)
        if values.dtype.kind not in "iu":
            raise FileError(f"array {name!r} must hold integers, not {values.dtype}")
        return frozen_int(values)


def is_own_file(file: Path, *, solutions: bool = False) -> bool:
    """Return True if the first bytes show that agglo wrote the file as a mesh (or a solution).

    May raise OSError.
    """
    heads = (MESH, SOLUTION) if solutions else (MESH,)
    with open(file, "rb") as stream:
        return stream.read(max(map(len, heads))).startswith(heads)


def face_stream(cells: Cells, number: Int | None) -> dict[str, NDArray[Any]]:
    """Encode polyhedra as face count, then size and vertices of each face, seen from outside.

    Other cells have the end −1 in the stream.
    """
    polyhedra = np.flatnonzero(cells.types == POLYHEDRON)
    all_cells = len(polyhedra) == len(cells.types)
    solids = cells.solids if all_cells else take_cells(cells.solids, frozen_int(polyhedra))
    offsets, loop_offsets, vertices = solids
    vertices = narrow(renumber_vertices(vertices, number))
    counts, sizes = np.diff(offsets), np.diff(loop_offsets)
    starts = loop_offsets[offsets] + offsets + np.arange(len(offsets))  # start of each cell, and the end
    loops = loop_offsets[:-1] + np.arange(len(sizes)) + np.repeat(np.arange(1, len(counts) + 1), counts)
    stream = np.empty(starts[-1], vertices.dtype)
    is_vertex = np.ones(len(stream), bool)
    is_vertex[starts[:-1]] = is_vertex[loops] = False
    stream[starts[:-1]], stream[loops], stream[is_vertex] = counts, sizes, vertices
    ends = np.full(len(cells.types), -1)
    ends[polyhedra] = starts[1:]
    return {"faces": stream, "faceoffsets": ends}
