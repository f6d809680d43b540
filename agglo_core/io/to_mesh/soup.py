"""Build a mesh from a list of cells, each given by its VTK type and its nodes.

A cell of the file becomes a mesh cell, a face tag, or is counted as dropped. Tags, global ids and listed
faces refer to cells; a type that stands for several cells must be split with all of them, before pieces are
joined (``soup_of_pieces`` in ``io/vtk/pieces.py``).

To add a type: an element of ``mesh/elements.py`` needs its number in ``_SHAPES``; another 3-D shape also
needs its faces there; a 2-D shape needs a row in ``_dimensions_and_corners`` and, if its nodes do not follow
its boundary, a case in ``_loops``.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int, trusted_copy
from agglo_core.errors import FileError, MeshError
from agglo_core.io.to_mesh.listed_faces import ListedFaces, faces_with, tags_of_faces
from agglo_core.io.to_mesh.point_sets import convex_hulls
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import check_tags, name_cells
from agglo_core.mesh.elements import (
    CORNERS,
    Polyhedra,
    concatenate,
    polyhedra_from_elements,
    take_cells,
)

_log = logging.getLogger("agglo")

# VTK types by shape. Additional nodes (quadratic, Lagrange, Bézier cells) follow the corners.
_SHAPES: Mapping[str, tuple[int, ...]] = {
    "tetra": (10, 24, 71, 78),
    "hexahedron": (12, 25, 29, 33, 72, 79),
    "voxel": (11,),
    "wedge": (13, 26, 31, 32, 73, 80),
    "pyramid": (14, 27, 37, 74, 81),
    "pentagonal prism": (15,),
    "hexagonal prism": (16,),
}
_STRIP, _POINT_SET = 6, 41
_POLYGON, _PIXEL, _QUADRATIC_POLYGON, _POLYHEDRON = 7, 8, 36, 42
_TRIANGLES, _QUADS = (5, 22, 34, 69, 76), (9, 23, 28, 30, 70, 77)
_LINES, _OTHER_LINES, _POINTS = (3, 21, 35, 68, 75), (4,), (0, 1, 2)
_VOXEL = (0, 1, 3, 2, 4, 5, 7, 6)  # voxel corners in hexahedron order


class Soup(NamedTuple):
    """List of cells of any type in file order, without adjacency.

    Cell c has the VTK type ``types[c]`` and the nodes ``vertices[offsets[c]:offsets[c + 1]]``;
    polyhedra (type 42) use the rows of ``solids`` in turn instead.
    """

    points: Float  # (n_points, 2 or 3)
    types: Int  # (n,)
    offsets: Int  # (n + 1,)
    vertices: Int
    solids: Polyhedra
    tags: Mapping[str, Int]  # name -> (n,)
    listed: ListedFaces | None = None
    point_ids: Int | None = None  # numbers in the whole mesh, if this is a piece
    cell_ids: Int | None = None


def mesh_from_soup(
    soup: Soup, *, merge_points: bool, allow_gaps: bool, drop_flat: bool, weak: bool, name: str
) -> Mesh:
    """Build a mesh from the cells of highest dimension.

    Cells of one dimension less become face tags.

    Cells of lower dimensions are dropped.

    Raises
    ------
    FileError
        For unsupported cell types or too few nodes.
    MeshError
        As :meth:`Mesh.from_polygons` and :meth:`Mesh.from_polyhedra`.
    """
    # Dimension and corners of each cell.
    dims, corners = _dimensions_and_corners()
    kind = np.where((soup.types >= 0) & (soup.types < 256), soup.types, 255)
    unknown = np.flatnonzero(dims[kind] < 0)
    if len(unknown):
        raise FileError(f"{name_cells(unknown)}: VTK cell type {soup.types[unknown[0]]} is not supported")
    sizes = _corner_counts(soup, corners[kind])
    dim = int(max(dims[kind].max(initial=0), 2))
    # Build the mesh from the cells of highest dimension, with gaps open.
    cells = np.flatnonzero(dims[kind] == dim)
    if not len(cells):
        raise MeshError(f"the mesh is empty: it has no 2-D or 3-D cells ({len(soup.types)} of other kinds)")
    tags = {key: values[cells] for key, values in soup.tags.items()}
    if dim == 2:
        mesh = Mesh.from_polygons(
            soup.points,
            _loops(soup, sizes, cells),
            cell_tags=tags,
            merge_points=merge_points,
            allow_gaps=True,
            drop_flat=drop_flat,
            weak=weak,
            name=name,
        )
    else:
        solids = _solids(soup, cells)
        mesh = Mesh.from_polyhedra(
            soup.points,
            solids,
            cell_tags=tags,
            merge_points=merge_points,
            allow_gaps=True,
            drop_flat=drop_flat,
            name=name,
        )
    # Match cells of one dimension less with faces.
    facets = np.flatnonzero(dims[kind] == dim - 1) if soup.tags else np.empty(0, np.int64)
    facets = facets[~np.isin(soup.types[facets], _OTHER_LINES)]
    face_tags, n_tagged = _face_tags(mesh, soup, _loops(soup, sizes, facets), facets)
    if soup.listed is not None and mesh.n_cells == len(soup.types):
        face_tags |= tags_of_faces(mesh, soup.points, soup.listed)
    # Record the repairs, then close the gaps.
    straightened = int((sizes < np.diff(soup.offsets))[cells].sum())
    repairs = {
        "higher-order cells reduced to their corners": straightened,
        "lower-dimensional cells dropped": len(soup.types) - len(cells) - n_tagged,
        "lower-dimensional cells kept as face tags": n_tagged,
    }
    mesh = record_repairs(trusted_copy(mesh, face_tags=check_tags("face", face_tags, mesh.n_faces)), repairs)
    return mesh if allow_gaps else mesh.conforming(merge_points=merge_points)  # after the face tags


def record_repairs(mesh: Mesh, repairs: Mapping[str, int]) -> Mesh:
    """Log changes made to a mesh on reading, and add their counts to ``mesh.repairs``."""
    counts = {text: count for text, count in repairs.items() if count}
    for text, count in counts.items():
        _log.info("%s: %d", text, count)
    return trusted_copy(mesh, repairs={**counts, **mesh.repairs}) if counts else mesh


def _dimensions_and_corners() -> tuple[Int, Int]:
    """Tabulate dimension (−1: unsupported) and corner count (0: all nodes) of VTK types 0 to 255."""
    dims, corners = np.full(256, -1), np.zeros(256, np.int64)
    for types, dim, count in (
        (_POINTS, 0, 0),
        (_LINES, 1, 2),
        (_OTHER_LINES, 1, 0),
        (_TRIANGLES, 2, 3),
        ((*_QUADS, _PIXEL), 2, 4),
        ((_POLYGON, _QUADRATIC_POLYGON, _STRIP), 2, 0),
        ((_POLYHEDRON, _POINT_SET), 3, 0),
        *((types, 3, CORNERS.get(shape, 8)) for shape, types in _SHAPES.items()),
    ):
        dims[list(types)], corners[list(types)] = dim, count
    return frozen_int(dims), frozen_int(corners)


def _corner_counts(soup: Soup, corners: Int) -> Int:
    """Return the corner count of each cell, without higher-order nodes.

    Raises FileError for cells with fewer nodes.
    """
    sizes = np.diff(soup.offsets)
    short_cells = np.flatnonzero(sizes < corners)
    if len(short_cells):
        c = int(short_cells[0])
        raise FileError(
            f"cell {c} of VTK type {soup.types[c]} has {sizes[c]} nodes, expected {corners[c]} or more"
        )
    sizes = np.where(corners > 0, corners, sizes)
    return frozen_int(np.where(soup.types == _QUADRATIC_POLYGON, sizes // 2, sizes))


def _loops(soup: Soup, sizes: Int, cells: Int) -> tuple[Int, Int]:
    """Return the corners of 2-D cells (or lines) as CSR, in order around the cell."""
    plain = not np.isin(soup.types, (_PIXEL, _STRIP)).any()
    if len(cells) == len(sizes) and np.array_equal(sizes, np.diff(soup.offsets)) and plain:
        return soup.offsets, soup.vertices
    offsets = np.concatenate(([0], np.cumsum(sizes[cells])))
    rank = np.arange(offsets[-1]) - np.repeat(offsets[:-1], sizes[cells])
    pixel, strip = (np.repeat(soup.types[cells] == kind, sizes[cells]) for kind in (_PIXEL, _STRIP))
    rank = np.where(pixel & (rank >= 2), 5 - rank, rank)
    if strip.any():  # nodes 0, 1, 3, 5, … on one side, then …, 4, 2 back on the other
        size = np.repeat(sizes[cells], sizes[cells])
        back = np.where(2 * rank <= size, np.maximum(2 * rank - 1, 0), 2 * (size - rank))
        rank = np.where(strip, back, rank)
    return frozen_int(offsets), frozen_int(soup.vertices[np.repeat(soup.offsets[cells], sizes[cells]) + rank])


def _solids(soup: Soup, cells: Int) -> Polyhedra:
    """Return the 3-D cells as polyhedra given by their faces, in file order."""
    parts, cell_blocks = [soup.solids], [np.flatnonzero(soup.types == _POLYHEDRON)]
    for shape, types in _SHAPES.items():
        shape_cells = np.flatnonzero(np.isin(soup.types, types))
        if not len(shape_cells):
            continue
        order = np.asarray(_VOXEL) if shape == "voxel" else np.arange(CORNERS[shape])
        element = "hexahedron" if shape == "voxel" else shape
        nodes = soup.vertices[soup.offsets[shape_cells][:, None] + order]
        parts.append(polyhedra_from_elements({element: nodes}))
        cell_blocks.append(shape_cells)
    shape_cells = np.flatnonzero(soup.types == _POINT_SET)
    parts.append(convex_hulls(soup.points, soup.offsets, soup.vertices, frozen_int(shape_cells)))
    cell_blocks.append(shape_cells)
    blocks = [k for k, shape_cells in enumerate(cell_blocks) if len(shape_cells)]
    if len(blocks) == 1:  # all of one shape
        return parts[blocks[0]]
    place = np.empty(len(soup.types), np.int64)
    place[np.concatenate(cell_blocks)] = np.arange(len(cells))
    return take_cells(concatenate(parts), frozen_int(place[cells]))


def _face_tags(mesh: Mesh, soup: Soup, loops: tuple[Int, Int], facets: Int) -> tuple[dict[str, Int], int]:
    """Convert lower-dimensional cells on mesh faces to face tags (−1 elsewhere), and count these cells.

    Points are matched by coordinates, because the construction of the mesh renumbers them.
    """
    if not len(facets):
        return {}, 0
    face = faces_with(mesh, soup.points, *loops)
    matches = np.flatnonzero(face >= 0)
    if not len(matches):
        return {}, 0
    tags = {}
    for name, values in soup.tags.items():
        # The largest of several values is kept.
        order = matches[np.argsort(values[facets[matches]], kind="stable")]
        tags[name] = np.full(mesh.n_faces, -1)
        tags[name][face[order]] = values[facets[order]]
        n_lost = int((tags[name][face[matches]] != values[facets[matches]]).sum())
        if n_lost and not np.isin(values[facets[matches]], (0, 1)).all():
            _log.warning("tag %r: %d cells on faces differ from the value kept, the largest", name, n_lost)
    return tags, len(matches)
