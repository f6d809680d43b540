"""Orient the faces of polyhedra that may have cavities (nested shells) or several components."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.mesh.elements import Polyhedra, gather

_CLOSED = 1e-9  # sum of the area vectors of a closed cell, relative to its surface
_SLIT = 1e-4  # maximum of this tolerance, where it grows for cells small relative to the rounding of points
_FLAT = 3e-15  # volume of a flat cell, relative to its surface to the power 3/2
_INSET = 1e-3  # distance of a test point from the edge of its face, relative to the height of the face
_TOUCH = 1e-12  # distance of a test point from a face that contains it, relative to the mesh

TWO_SHELLS = 8
"""Smallest number of faces in a cell with two shells."""

# a generic direction, and two directions that span the plane across it (a right-handed frame)
_PLANE = np.array([[0.9, -0.22], [0.36, 0.85], [-0.24, 0.48]])
_PLANE = np.linalg.qr(_PLANE)[0]  # orthonormal columns
_LINE = np.cross(*_PLANE.T)


class _Surface(NamedTuple):
    """Half-faces, with the sign that orients each away from the interior of its closed shell."""

    loop_offsets: Int
    vertices: Int
    points: Float
    vector: Float
    centre: Float
    side: Float


def _max_gap(area: Float, off: float) -> Float:
    """Return the largest sum of the area vectors of closed cells with these surface areas."""
    slit = np.minimum(off * np.sqrt(area), _SLIT * area)
    return np.asarray(np.maximum(_CLOSED * area, slit))


def signs_of_plain_cells(solids: Polyhedra, points: Float, off: float) -> Float | None:
    """Return :func:`outward_signs` of half-faces, or None if a cell needs more than one pass over its faces.

    Plain cells are star-shaped about the mean of their face centres, closed, have a volume, and too few faces
    for two shells.
    """
    from agglo_core.mesh.kernels.face_loops import cell_surfaces

    counts = np.diff(solids.cell_offsets)
    if counts.max() >= TWO_SHELLS:
        return None
    sums = np.empty((len(counts), 5))
    cell_surfaces(points, *solids, sums)
    area, gap, least, most, total = sums.T
    is_plain = ((least >= 0) | (most <= 0)) & (gap <= _max_gap(area, off)) & ~_is_flat(total, area)
    return frozen_float(np.repeat(np.sign(total), counts)) if is_plain.all() else None


def _is_flat(total: Float, area: Float) -> Mask:
    """Return the mask of cells without volume, from three times the volume, and the area."""
    return np.asarray(np.abs(total) <= _FLAT * area**1.5)


def outward_signs(
    cell_of: Int, loop_offsets: Int, vertices: Int, points: Float, vector: Float, centre: Float, off: float
) -> tuple[Float, Int, Mask]:
    """Return the sign of each half-face: −1 where its loop is clockwise seen from outside the cell.

    Parameters
    ----------
    cell_of : (n,) int
        Cell per half-face, 0 to k − 1, increasing, without gaps.
    loop_offsets, vertices
        Half-face loops as CSR.
    points : (n_points, 3) float
        Coordinates near the origin, to limit rounding.
    vector, centre : (n, 3) float
        Half-face area vectors and centroids.
    off : float
        Distance of hanging points from their edge. Between the tiles and neighbours of a split face there is
        a slit of this width.

    Returns
    -------
    sign : (n,) float
    open_ : int
        Cells whose faces are not closed or cannot be oriented.
    flat : (k,) bool
        True for cells without volume.

    Notes
    -----
    A cell that is star-shaped about the mean of its face centres is oriented by its face directions alone. In
    other cells, faces with a common edge are oriented consistently. Each shell is then oriented outward if
    the cell has an even number of other shells around it, otherwise inward, because it bounds a cavity.
    """
    from agglo_core.mesh.kernels.solid_cells import surfaces

    # Star-shaped cells: all faces look away from the middle, or all towards it.
    offsets = frozen_int(np.concatenate(([0], np.cumsum(np.bincount(cell_of)))))
    area, gap, least, most, total, *middle = surfaces(offsets, vector, centre).T
    max_gap = _max_gap(area, off)
    is_star = ((least >= 0) | (most <= 0)) & (gap <= max_gap)
    perhaps = frozen_int(np.flatnonzero(is_star & (np.diff(offsets) >= TWO_SHELLS)))
    if len(perhaps):
        eyes = np.stack(middle, axis=1)[perhaps] @ _PLANE
        count, halves = gather(offsets, perhaps)
        is_star[perhaps] = _star_shaped(count, halves, loop_offsets, vertices, points, vector, eyes)
    # Other cells: orient shell by shell.
    doubtful = frozen_int(np.flatnonzero(~is_star[cell_of]))
    sign = np.ones(len(cell_of))
    if len(doubtful):
        loops, places = gather(loop_offsets, doubtful)
        sign[doubtful] = _orient_shells(
            frozen_int(cell_of[doubtful]),
            loops,
            frozen_int(vertices[places]),
            points,
            frozen_float(vector[doubtful]),
            frozen_float(centre[doubtful]),
        )
        _, gap, _, _, total, *_ = surfaces(offsets, frozen_float(vector * sign[:, None]), centre).T
    return (
        frozen_float(sign * np.sign(total)[cell_of]),
        frozen_int(np.flatnonzero(~(gap <= max_gap))),
        _is_flat(total, area),
    )


def _star_shaped(
    offsets: Int, halves: Int, loop_offsets: Int, vertices: Int, points: Float, vector: Float, eyes: Float
) -> Mask:
    """Return the mask of cells where a line through the centre meets exactly one face on either side.

    All faces of these cells look away from the middle, or all towards it, so the line meets every shell
    around the middle. Cell c has the faces ``halves[offsets[c]:offsets[c + 1]]``; ``eyes`` are the projected
    middles.
    """
    cell = np.repeat(np.arange(len(eyes)), np.diff(offsets))
    met = np.abs(_turns(loop_offsets, vertices, points @ _PLANE, halves, eyes[cell]))
    front = vector[halves] @ _LINE > 0
    both = np.bincount(cell, met, len(eyes))
    return np.asarray((both == 2) & (np.bincount(cell, met * front, len(eyes)) == 1))


def _turns(offsets: Int, vertices: Int, projections: Float, loops: Int, eyes: Float) -> Int:
    """Return each loop's winding number, projected along a line, about its point in ``eyes``."""
    starts, places = gather(offsets, loops)
    loop = np.repeat(np.arange(len(loops)), np.diff(starts))
    # Edges that cross the height of the point, closing edges included.
    vertex = vertices[places]
    above = projections[:, 1][vertex] > eyes[:, 1][loop]
    changes = above[1:] != above[:-1]
    changes[starts[1:-1] - 1] = False
    last = starts[1:] - 1
    closing = np.flatnonzero(above[last] != above[starts[:-1]])
    tail = np.concatenate((np.flatnonzero(changes), last[closing]))
    head = np.concatenate((np.flatnonzero(changes) + 1, starts[:-1][closing]))
    # Count those to the right of the point, +1 upwards and −1 downwards.
    around = loop[tail]
    (x, y), (u, v) = ((projections[vertex[ends]] - eyes[around]).T for ends in (tail, head))
    way = np.where(v > y, 1, -1)
    right = (x * v - u * y) * way > 0
    return frozen_int(np.bincount(around[right], way[right], len(loops)))


def _orient_shells(
    cell_of: Int, loop_offsets: Int, vertices: Int, points: Float, vector: Float, centre: Float
) -> Float:
    """Return half-face signs that orient outer shells outward, and shells of cavities inward."""
    links, loose = _links(cell_of, loop_offsets, vertices, points, vector)
    patch, side = _two_sides(*links, len(cell_of))
    shell = _shells(patch, cell_of, *loose)
    first, shell = np.unique(shell, return_index=True, return_inverse=True)[1:]
    # Orient each patch outward: the flux of the position about the middle of its shell is positive.
    count = np.bincount(shell)
    middle = np.stack([np.bincount(shell, column) / count for column in centre.T], axis=1)
    flux = ((centre - middle[shell]) * vector).sum(axis=1) * side
    side = np.where(np.bincount(patch, flux)[patch] < 0, -side, side)
    cells = frozen_int(cell_of[first])
    if (np.diff(cells) == 0).any():
        surface = _Surface(loop_offsets, vertices, points, vector, centre, frozen_float(side))
        depth = _depths(surface, frozen_int(shell), cells)
        side = side * (1 - 2 * (depth % 2))[shell]
    return frozen_float(side)


def _links(
    cell_of: Int, loop_offsets: Int, vertices: Int, points: Float, vector: Float
) -> tuple[tuple[Int, Int, Mask], tuple[Int, Int]]:
    """Return half-face pairs that share a cell edge, and the mask of inconsistently oriented pairs.

    Also return the half-faces and vertices at edges with an odd number of faces (hanging vertices listed by
    some faces only).
    """
    # Group the half-edges of each cell by edge.
    loop = np.repeat(np.arange(len(cell_of)), np.diff(loop_offsets))
    head = np.roll(vertices, -1)
    head[loop_offsets[1:] - 1] = vertices[loop_offsets[:-1]]
    low, high, cell = np.minimum(vertices, head), np.maximum(vertices, head), cell_of[loop]
    order = np.lexsort((high, low, cell))
    step = np.stack((cell, low, high))[:, order]
    start = np.flatnonzero(np.concatenate(([True], (np.diff(step, axis=1) != 0).any(axis=0))))
    size = np.diff(np.append(start, len(order)))
    group = np.repeat(np.arange(len(start)), size)
    way = np.where(vertices == low, 1, -1)
    crowded = np.flatnonzero((size > 2)[group])
    if len(crowded):  # several shells, or a shell that touches itself: sort by angle around the edge
        edges = order[crowded]
        tangent = _units(points[high[edges]] - points[low[edges]])
        inward = np.cross(_units(vector[loop[edges]]), tangent) * way[edges, None]
        is_first = np.diff(group[crowded], prepend=-1) != 0
        axis = inward[np.flatnonzero(is_first)][np.cumsum(is_first) - 1]
        second_axis = np.cross(tangent, axis)
        angle = np.arctan2((inward * second_axis).sum(axis=1), (inward * axis).sum(axis=1))
        order[crowded] = edges[np.lexsort((angle, group[crowded]))]
    # Pair consecutive half-faces at edges with an even number of faces.
    is_even = size % 2 == 0
    pairs = np.flatnonzero((np.diff(group) == 0) & is_even[group[:-1]])
    f, g = order[pairs], order[pairs + 1]
    loose = order[~is_even[group]]
    return (
        (frozen_int(loop[f]), frozen_int(loop[g]), way[f] == way[g]),
        (frozen_int(loop[loose]), frozen_int(vertices[loose])),
    )


def _units(vectors: Float) -> Float:
    """Return vectors ``(n, 3)`` scaled to length 1.

    Zero vectors stay zero.
    """
    length = np.linalg.norm(vectors, axis=1)
    return frozen_float(vectors / np.where(length > 0, length, 1.0)[:, None])


def _two_sides(f: Int, g: Int, clash: Mask, n: int) -> tuple[Int, Float]:
    """Return the edge-connected patch per face, and signs that orient each patch consistently.

    Faces f and g share an edge; where ``clash`` is True, one of them must turn. Each face is represented by
    two nodes, as listed and turned. The connected components are then the two orientations of each patch.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    turn = n * clash
    rows, columns = np.concatenate((f, f + n)), np.concatenate((g + turn, g + n - turn))
    links = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * n, 2 * n))
    component = connected_components(links, directed=False)[1]
    patch = np.minimum(component[:n], component[n:])
    return frozen_int(patch), frozen_float(np.where(component[:n] == patch, 1.0, -1.0))


def _shells(patch: Int, cell_of: Int, loops: Int, vertices: Int) -> Int:
    """Return the shell of each face: its patch, united with patches that share vertices of open edges."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(loops):
        return patch
    key = np.unique(np.stack((cell_of[loops], vertices)), axis=1, return_inverse=True)[1].ravel()
    n = int(patch.max()) + 1
    size = n + int(key.max()) + 1
    links = coo_array((np.ones(len(key)), (patch[loops], n + key)), shape=(size, size))
    return frozen_int(connected_components(links, directed=False)[1][patch])


def _depths(surface: _Surface, shell: Int, cells: Int) -> Float:
    """Return each shell's nesting depth: the number of shells around it in the same cell.

    The depth is the sum of the other shells' face windings along a ray from a point on the shell. It is NaN
    if the point lies on such a face, because the shells then share a part of a face.
    """
    offsets, vertices, points, vector, centre, side = surface
    test = _test_points(surface, shell, len(cells))
    inner, face = _faces_in_line(surface, test, shell, cells)
    turns = _turns(offsets, vertices, points @ _PLANE, face, (test @ _PLANE)[inner])
    met = np.flatnonzero(turns)
    inner, face = inner[met], face[met]
    distance = ((centre[face] - test[inner]) * vector[face]).sum(axis=1) / (vector[face] @ _LINE)
    winding = turns[met] * side[face]
    depth = np.bincount(inner, winding * (distance > 0), len(cells)).astype(float)
    depth[inner[np.abs(distance) < _TOUCH * np.abs(points).max()]] = np.nan
    return frozen_float(depth)


def _faces_in_line(surface: _Surface, test: Float, shell: Int, cells: Int) -> tuple[Int, Int]:
    """Return pairs (shell, face) where the shell's test line meets the box of another shell's face."""
    import shapely

    several = np.bincount(cells)[cells] > 1
    shells, faces = np.flatnonzero(several), np.flatnonzero(several[shell])
    corners = surface.points @ _PLANE
    # place the cells side by side, so that no line meets the faces of another cell
    shift = 3 * np.abs(corners).max() * np.unique(cells, return_inverse=True)[1]
    slack = 1e-14 * np.abs(shift).max() + 1e-9 * np.abs(corners).max()
    offsets, places = gather(surface.loop_offsets, frozen_int(faces))
    visited = corners[surface.vertices[places]]
    visited[:, 0] += np.repeat(shift[shell[faces]], np.diff(offsets))
    low, high = (least.reduceat(visited, offsets[:-1]) for least in (np.minimum, np.maximum))
    boxes = shapely.box(*(low - slack).T, *(high + slack).T)
    eyes = test[shells] @ _PLANE
    eyes[:, 0] += shift[shells]
    inner, face = shapely.STRtree(boxes).query(shapely.points(eyes))
    inner, face = shells[inner], faces[face]
    other = shell[face] != inner
    return frozen_int(inner[other]), frozen_int(face[other])


def _test_points(surface: _Surface, shell: Int, n: int) -> Float:
    """Return a test point ``(n, 3)`` per shell: in its largest face, near the longest edge's midpoint."""
    area = np.linalg.norm(surface.vector, axis=1)
    order = np.lexsort((area, shell))
    last = np.append(np.flatnonzero(np.diff(shell[order])), len(order) - 1)
    # Loops of the largest faces, and their longest edges.
    face = frozen_int(order[last])
    offsets, places = gather(surface.loop_offsets, face)
    ahead = np.roll(places, -1)
    ahead[offsets[1:] - 1] = places[offsets[:-1]]
    tail, head = (surface.points[surface.vertices[ends]] for ends in (places, ahead))
    length = np.linalg.norm(head - tail, axis=1)
    rows = np.repeat(np.arange(n), np.diff(offsets))
    order = np.lexsort((length, rows))
    longest = order[offsets[1:] - 1]
    edge = (head - tail)[longest]
    # move into the face, across the edge, by a small part of its height
    height = area[face] / np.where(length > 0, length, 1.0)[longest]
    inward = np.cross(_units(surface.vector[face]), _units(edge)) * height[:, None]
    return frozen_float(0.5 * (head + tail)[longest] + _INSET * inward)
