"""Convert cells to VTK's cell types: VTK elements where possible, otherwise polygons or polyhedra."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.io.to_mesh.bridges import single_loops
from agglo_core.io.to_mesh.plain_cells import half_faces
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import (
    CORNERS,
    Polyhedra,
    gather,
    polyhedra_from_elements,
    take_cells,
    turns_as_listed,
)

_TRIANGLE, _POLYGON, _QUAD = 5, 7, 9
POLYHEDRON = 42
_CHUNK = 8192  # cells per chunk: temporary arrays stay in cache and need little memory
_CONVEX = 1e-9  # minimum corner triangle of a convex quadrilateral, relative to its area


class _Element(NamedTuple):
    """One of VTK's 3-D elements, with its face sizes and its rotation group."""

    number: int
    sizes: tuple[int, ...]  # of its faces; the first sizes are those of faces equivalent under rotation
    turns: tuple[tuple[int, ...], ...]  # corner permutations that generate its rotation group


_ELEMENTS: Mapping[str, _Element] = {
    "tetra": _Element(10, (3, 3, 3, 3), ((1, 2, 0, 3), (1, 0, 3, 2))),
    "hexahedron": _Element(12, (4,) * 6, ((1, 2, 3, 0, 5, 6, 7, 4), (3, 2, 6, 7, 0, 1, 5, 4))),
    "wedge": _Element(13, (3, 3, 4, 4, 4), ((1, 2, 0, 4, 5, 3), (3, 5, 4, 0, 2, 1))),
    "pyramid": _Element(14, (4, 3, 3, 3, 3), ((1, 2, 3, 0, 4),)),
}


class Cells(NamedTuple):
    """Cells of a mesh as VTK stores them: types, points and faces.

    Cell c has the type ``types[c]`` and the points ``vertices[offsets[c]:offsets[c + 1]]``, in VTK's order.
    """

    types: NDArray[np.uint8]  # (n_cells,)
    offsets: Int  # (n_cells + 1,)
    vertices: Int
    solids: Polyhedra  # faces of every cell of a 3-D mesh, counter-clockwise from outside
    loops: Int  # (n_cells,) number of boundary loops that a polygon joins by bridges


def cells_of(mesh: Mesh) -> Cells:
    """Return the cells of a mesh, each with the most specific VTK type that fits.

    Triangles and convex quadrilaterals are VTK elements, other 2-D cells polygons, because VTK assumes that
    quadrilaterals are convex. Tetrahedra, hexahedra, wedges and pyramids are VTK elements if their faces
    match and no quadrilateral face is non-convex; other 3-D cells are polyhedra.
    """
    if mesh.dim == 2:
        return _plane(mesh)
    solids = half_faces(mesh)
    offsets, cell_vertices = mesh.cell_vertices
    types, vertices = np.full(mesh.n_cells, POLYHEDRON, np.uint8), np.array(cell_vertices, np.int64)
    has_bent_face = np.logical_or.reduceat(
        _nonconvex_quads(mesh)[mesh.cell_faces[1]], solids.cell_offsets[:-1]
    )
    # Test candidates by counts first, then by topology.
    for kind, element in _ELEMENTS.items():
        candidates = np.flatnonzero(_matches_counts(kind, solids, offsets) & ~has_bent_face)
        for start in range(0, len(candidates), _CHUNK):
            cells, corners = _elements(mesh, solids, kind, frozen_int(candidates[start : start + _CHUNK]))
            types[cells] = element.number
            vertices[offsets[cells][:, None] + np.arange(CORNERS[kind])] = corners
    return Cells(types, offsets, frozen_int(vertices), solids, frozen_int(np.ones(mesh.n_cells)))


def select_cells(cells: Cells, chosen: Int) -> Cells:
    """Return the cells with the given indices, in this order."""
    offsets, places = gather(cells.offsets, chosen)
    solid = len(cells.solids.cell_offsets) > 1
    return Cells(
        cells.types[chosen],
        offsets,
        frozen_int(cells.vertices[places]),
        take_cells(cells.solids, chosen) if solid else cells.solids,
        frozen_int(cells.loops[chosen]),
    )


def _plane(mesh: Mesh) -> Cells:
    offsets, vertices, loops = single_loops(mesh)
    sizes = np.diff(offsets)
    types = np.where(sizes == 3, _TRIANGLE, _POLYGON).astype(np.uint8)
    quads = np.flatnonzero(sizes == 4)
    convex = _is_convex(mesh.local_points[vertices[offsets[quads][:, None] + np.arange(4)]])
    types[quads[convex]] = _QUAD
    none = frozen_int([0])
    return Cells(types, offsets, vertices, Polyhedra(none, none, none[:0]), loops)


def _is_convex(corners: Float) -> Mask:
    """Return a mask ``(q,)`` of the convex ones among quadrilaterals ``(q, 4, d)``.

    Convexity is measured with respect to the area vector.
    """
    a, b, c, d = (corners[:, k] for k in range(4))
    area = _cross(c - a, d - b)
    least = _CONVEX * (area * area).sum(axis=1)
    convex = np.ones(len(corners), bool)
    for p, q, r in ((a, b, c), (b, c, d), (c, d, a), (d, a, b)):
        convex &= (_cross(q - p, r - q) * area).sum(axis=1) > least
    return convex


def _cross(u: Float, v: Float) -> Float:
    """Return the cross products of q pairs of vectors as ``(q, 3)``, in 2-D their z component ``(q, 1)``."""
    if u.shape[1] == 3:
        return np.cross(u, v)
    return (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])[:, None]


def _nonconvex_quads(mesh: Mesh) -> Mask:
    """Return a mask ``(n_faces,)`` of the non-convex quadrilateral faces of a 3-D mesh."""
    is_nonconvex = np.zeros(mesh.n_faces, bool)
    quads = np.flatnonzero(np.diff(mesh.face_offsets) == 4)
    corners = mesh.face_vertices[mesh.face_offsets[quads][:, None] + np.arange(4)]
    is_nonconvex[quads] = ~_is_convex(mesh.local_points[corners])
    return is_nonconvex


def _matches_counts(kind: str, solids: Polyhedra, vertex_offsets: Int) -> Mask:
    """Return a mask of cells with as many vertices, faces and face corners as an element type."""
    sizes = _ELEMENTS[kind].sizes
    corners = np.diff(solids.loop_offsets[solids.cell_offsets])
    alike = (np.diff(vertex_offsets) == CORNERS[kind]) & (np.diff(solids.cell_offsets) == len(sizes))
    return np.asarray(alike & (corners == sum(sizes)))


def _elements(mesh: Mesh, solids: Polyhedra, kind: str, cells: Int) -> tuple[Int, Int]:
    """Select the cells that are elements of a type, and return their corners in VTK's order ``(n, k)``.

    The cells have as many vertices, faces and face corners as the element.
    """
    from agglo_core.mesh.kernels.elements import match_elements

    walk, following = _reference(kind)
    corners = np.empty((len(cells), CORNERS[kind]), np.int64)
    fits = match_elements(cells, *solids, _ELEMENTS[kind].sizes[0], walk, following, corners)
    element_cells, corners = frozen_int(cells[fits]), frozen_int(corners[fits])
    return element_cells, _rotate_corners(mesh, kind, element_cells, corners)


@cache
def _reference(kind: str) -> tuple[Int, Int]:
    """Return the corners of an element along its first face and beyond, and the corner after each edge.

    See ``match_elements``.
    """
    loops = [loop.tolist() for loop in _faces(kind)]
    following = np.full((8, 8), -1)
    for loop in loops:
        for place, corner in enumerate(loop):
            following[loop[place - 2], loop[place - 1]] = corner
    base = next(loop for loop in loops if len(loop) == _ELEMENTS[kind].sizes[0])
    beyond = [following[b, a] for a, b in zip(base, base[1:] + base[:1], strict=True)]
    return frozen_int([*base, *beyond]), frozen_int(following)


def _faces(kind: str) -> list[Int]:
    """Return the corners of each face of an element, counter-clockwise from outside."""
    table = polyhedra_from_elements({kind: [range(CORNERS[kind])]})
    return np.split(table.vertices, table.loop_offsets[1:-1])


def _rotate_corners(mesh: Mesh, kind: str, cells: Int, corners: Int) -> Int:
    """Rotate the corners of each element so that reading the file reproduces the order of its faces.

    A mesh of elements then survives a round trip bit by bit. Without such a rotation the corners are
    unchanged.
    """
    from agglo_core.mesh.kernels.elements import first_corners

    faces = _faces(kind)
    rank = np.full((8, 8), -1)
    for place, face in enumerate(faces):
        rank[face[0], face[1]] = place
    first, second = (np.empty((len(cells), len(faces)), np.int64) for _ in range(2))
    first_corners(cells, *mesh.cell_faces, mesh.face_offsets, mesh.face_vertices, corners, first, second)
    rows = mesh.cell_faces[1][mesh.cell_faces[0][cells][:, None] + np.arange(len(faces))]
    is_owner = mesh.face_cells[rows, 0] == cells[:, None]
    turns = frozen_int(_turns(kind))
    choice = turns_as_listed(frozen_int(first), frozen_int(second), is_owner, turns, frozen_int(rank))
    order = np.where(choice[:, None] >= 0, turns[choice], np.arange(CORNERS[kind]))
    return frozen_int(np.take_along_axis(corners, order, axis=1))


@cache
def _turns(kind: str) -> tuple[tuple[int, ...], ...]:
    """Return all corner permutations that are rotations of the element."""
    orders = [tuple(range(CORNERS[kind]))]
    for order in orders:  # grows while it is walked through
        for turn in _ELEMENTS[kind].turns:
            turned = tuple(order[place] for place in turn)
            if turned not in orders:
                orders.append(turned)
    return tuple(orders)
