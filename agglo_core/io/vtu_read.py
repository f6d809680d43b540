"""Reading VTU (VTK XML unstructured grids): every encoding, several pieces, polyhedra in both layouts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.format_options import ReadOptions
from agglo_core.io.listed_faces import ListedFaces, listed_faces
from agglo_core.io.soup import Soup
from agglo_core.io.tags import tag_values
from agglo_core.io.vtk_pieces import Stored, check_counts, mesh_from_pieces, soup_of_piece
from agglo_core.io.vtu_arrays import TYPES, Document, is_derived, parse
from agglo_core.mesh import Mesh

__all__ = ["read_vtu", "stored_pieces"]

_FACES = 64  # numbers about faces for each cell, beyond which an array is looked at before it is decoded


def read_vtu(path: Path, **options: Unpack[ReadOptions]) -> Mesh:
    """Mesh of a VTU file; its pieces are joined, integer cell data become cell tags.

    Raises
    ------
    FileError, MeshError
        For a broken file or mesh.
    """
    return mesh_from_pieces(stored_pieces(path.read_bytes()), **options, name=path.stem)


def stored_pieces(content: bytes) -> Stored:
    """The pieces of a VTU file; raises FileError."""
    document = parse(content)
    grid = document.root.find("UnstructuredGrid")
    if grid is None:
        return Stored([], [])
    _check_places(grid.iterfind(".//DataArray"))
    data = grid.iterfind("Piece/CellData/DataArray")
    left = [each.get("Name", "") for each in data if not _is_tag(each) and not is_derived(each)]
    pieces = [_piece(document, piece) for piece in grid.findall("Piece")]
    ours = document.root.get("agglo") == "mesh"
    if len(pieces) == 1 and ours:  # in files of others it may be out of date
        pieces = [pieces[0]._replace(listed=_listed(document, grid, pieces[0]))]
    return Stored(pieces, left, ours)


def _listed(document: Document, grid: ElementTree.Element, piece: Soup) -> ListedFaces | None:
    """Faces with tags, from the field data."""
    n, elements = len(piece.types), grid.findall("FieldData/DataArray")
    fields = {each.get("Name", ""): document.array(each, _FACES * n) for each in elements}
    return listed_faces(fields, len(piece.points), n)


def _check_places(elements: Iterable[ElementTree.Element]) -> None:
    """Refuse arrays that share their bytes: a small file could say the same thing a million times."""
    names: dict[int, str] = {}
    for element in elements:
        if element.get("format") != "appended":
            continue
        name = element.get("Name", "Points")
        try:
            place = int(element.get("offset", ""))
        except ValueError:  # refused if it is read
            continue
        if place in names:
            raise FileError(f"arrays {names[place]!r} and {name!r} begin at the same appended byte, {place}")
        names[place] = name


def _piece(document: Document, piece: ElementTree.Element) -> Soup:
    try:
        n_points, n = (int(piece.get(key, "")) for key in ("NumberOfPoints", "NumberOfCells"))
    except ValueError:
        raise FileError("a Piece does not say its NumberOfPoints and NumberOfCells") from None
    check_counts(n_points, n)
    points = _points(document, piece, n_points)
    cells = {element.get("Name", ""): element for element in piece.iterfind("Cells/DataArray")}
    soup = soup_of_piece(_Arrays(document, cells), points, n)
    point_ids = _ids(document, piece.find("PointData"), n_points)
    cell_ids = _ids(document, piece.find("CellData"), n)
    return soup._replace(tags=_tags(document, piece, n) if n else {}, point_ids=point_ids, cell_ids=cell_ids)


def _ids(document: Document, section: ElementTree.Element | None, n: int) -> Int | None:
    """The n integers that a section declares to be its global ids, if it does."""
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
    element = piece.find("Points/DataArray")
    values = document.array(element, 3 * n) if element is not None else np.empty(0)
    if values.size != 3 * n:
        raise FileError(f"a Piece of {n} points has {values.size} coordinates, expected {3 * n}")
    return frozen_float(values.reshape(-1, 3))


def _tags(document: Document, piece: ElementTree.Element, n: int) -> dict[str, Int]:
    """Integer cell data of one component."""
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
    """Whether cell data are named integers of one component, and not what agglo derived from the mesh."""
    if is_derived(element):
        return False
    kind = element.get("type", "")
    single = element.get("NumberOfComponents", "1").strip() in ("0", "1")
    return bool(element.get("Name")) and kind.startswith(("Int", "UInt")) and kind in TYPES and single


@dataclass(frozen=True)
class _Arrays:
    document: Document
    cells: dict[str, ElementTree.Element]

    def __contains__(self, name: str) -> bool:
        return name in self.cells

    def take(self, name: str, declared: int) -> Int:
        """Integers of an array that should have ``declared`` values."""
        if name not in self.cells:
            raise FileError(f"array {name!r} is missing from Cells; found {', '.join(self.cells) or 'none'}")
        values: NDArray[Any] = self.document.array(self.cells[name], declared)
        if values.dtype.kind not in "iu":
            raise FileError(f"array {name!r} must hold integers, not {values.dtype}")
        return frozen_int(values)
