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
            cells, corners = _elements(mesh, solids, kind, candidates[start : start + _CHUNK])
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

    One face and the edges that leave it determine the corners; then all faces are compared with the faces of
    the element.
    """
    # Sort the faces of each cell by size and compare the sizes.
    sizes = frozen_int(_ELEMENTS[kind].sizes)
    _, loops = gather(solids.cell_offsets, frozen_int(cells))
    owner = np.repeat(np.arange(len(cells)), len(sizes))
    size = solids.loop_offsets[loops + 1] - solids.loop_offsets[loops]
    order = np.lexsort((size != sizes[0], owner))
    fits = (size[order].reshape(-1, len(sizes)) == sizes).all(axis=1)
    cells, loops = cells[fits], loops[order].reshape(-1, len(sizes))[fits].ravel()
    # Number the corners along the first face and across its edges.
    around = solids.vertices[gather(solids.loop_offsets, frozen_int(loops))[1]].reshape(-1, sizes.sum())
    reference = _reference(kind)
    corners = np.empty((len(cells), CORNERS[kind]), np.int64)
    corners[:, _walk(reference, sizes)[0]] = _walk(around, sizes)
    # Compare all faces with the reference element.
    expected = _triples(reference, frozen_int([range(CORNERS[kind])]), sizes)
    is_element = (_triples(around, corners, sizes) == expected).all(axis=1)
    element_cells, corners = frozen_int(cells[is_element]), frozen_int(corners[is_element])
    return element_cells, _rotate_corners(mesh, kind, element_cells, corners)


@cache
def _reference(kind: str) -> Int:
    """Return the concatenated face vertices ``(1, c)`` of the reference element."""
    table = polyhedra_from_elements({kind: [range(CORNERS[kind])]})
    sizes = np.diff(table.loop_offsets)
    order = np.argsort(sizes != _ELEMENTS[kind].sizes[0], kind="stable")
    return frozen_int(table.vertices[gather(table.loop_offsets, frozen_int(order))[1]][None])


def _neighbours(sizes: Int) -> tuple[Int, Int]:
    """Return for each entry of concatenated face loops the index of the previous and the next corner."""
    ends = np.cumsum(sizes)
    before, after = np.arange(ends[-1]) - 1, np.arange(ends[-1]) + 1
    before[ends - sizes], after[ends - 1] = ends - 1, ends - sizes
    return frozen_int(before), frozen_int(after)


def _walk(around: Int, sizes: Int) -> Int:
    """Return the vertices of each cell's first face, then their neighbours outside this face."""
    before, after = _neighbours(sizes)
    base, rows, tops = around[:, : sizes[0]], np.arange(len(around)), []
    for here, there in zip(base.T, np.roll(base, -1, axis=1).T, strict=True):
        meets = (around == here[:, None]) & (around[:, before] == there[:, None])
        tops.append(around[rows, after[np.argmax(meets, axis=1)]])
    return frozen_int(np.concatenate((base, np.stack(tops, axis=1)), axis=1))


def _triples(around: Int, corners: Int, sizes: Int) -> Int:
    """Encode each face corner and its two neighbours as one integer, sorted within each cell."""
    local = _local(around, corners)
    before, after = _neighbours(sizes)
    return frozen_int(np.sort((local[:, before] * 8 + local) * 8 + local[:, after], axis=1))


def _local(vertices: Int, corners: Int) -> Int:
    """Return the local index of each vertex ``(n, c)`` among the corners ``(n, k)`` of its cell."""
    local = np.zeros(vertices.shape, np.int64)
    for place, corner in enumerate(corners.T):
        local[vertices == corner[:, None]] = place
    return frozen_int(local)


def _rotate_corners(mesh: Mesh, kind: str, cells: Int, corners: Int) -> Int:
    """Rotate the corners of each element so that reading the file reproduces the order of its faces.

    A mesh of elements then survives a round trip bit by bit. Without such a rotation the corners are
    unchanged.
    """
    table = polyhedra_from_elements({kind: [range(CORNERS[kind])]})
    rank = np.full((8, 8), -1)
    starts = table.loop_offsets[:-1]
    rank[table.vertices[starts], table.vertices[starts + 1]] = np.arange(len(starts))
    faces = mesh.cell_faces[1][gather(mesh.cell_faces[0], cells)[1]].reshape(-1, len(starts))
    is_owner = mesh.face_cells[faces, 0] == cells[:, None]
    first, second = (_local(mesh.face_vertices[mesh.face_offsets[faces] + i], corners) for i in (0, 1))
    turns = frozen_int(_turns(kind))
    choice = turns_as_listed(first, second, is_owner, turns, frozen_int(rank))
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
