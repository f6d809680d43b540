"""From polyhedra as given to a checked 3-D Mesh: half-faces are paired, turned outward, checked."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import (
    box_centre,
    check_extent,
    check_finite,
    check_indices,
    check_offsets,
    check_points,
    compact_points,
    last_place,
    name_cells,
    note_repairs,
    whole_numbers,
)
from agglo_core.mesh.geometry3d import face_moments
from agglo_core.mesh.polygons import Faces

__all__ = ["build_polyhedra", "solids_as_csr"]

_CLOSED = 1e-9  # of a cell's surface: what its area vectors may add up to
_SLIT = 1e-4  # the same for cells that are small beside the rounding of their coordinates
_ROUNDING = 8  # units in the last place that points may be off an edge or a face that they lie on


def build_polyhedra(points: ArrayLike, cells: Any, merge_points: bool) -> Faces:
    """Faces of polyhedra given as loops; arguments and errors are those of ``Mesh.from_polyhedra``."""
    points = check_points(points)
    if points.shape[1] != 3:
        raise MeshError(f"polyhedra need points of shape (n_points, 3), not {points.shape}")
    cell_offsets, loop_offsets, vertices = solids_as_csr(cells)
    _check_counts(cell_offsets, loop_offsets, vertices)
    check_indices(loop_offsets[cell_offsets], vertices, len(points))
    check_finite(points, vertices)
    used, vertices, repairs = compact_points(points, vertices, merge_points)
    points = frozen_float(points[used])
    check_extent(points)
    cell_of = frozen_int(np.repeat(np.arange(len(cell_offsets) - 1), np.diff(cell_offsets)))
    _refuse_repeats(cell_of, loop_offsets, vertices, len(points))
    local = frozen_float(points - box_centre(points))
    vector, centre = face_moments(local, loop_offsets, vertices)
    sign = _outward(cell_of, loop_offsets, vertices, vector, centre, _ROUNDING * last_place(points))
    repairs["faces turned outward"] = int((sign < 0).sum())
    owner, neighbour = _match(cell_of, loop_offsets, vertices, used)
    _refuse_overlaps(cell_of, owner, neighbour, vector * sign[:, None])
    keep_offsets, keep_vertices = _take_loops(loop_offsets, vertices, owner, sign[owner] > 0)
    sides = np.where(neighbour >= 0, cell_of[neighbour], -1)
    face_cells = frozen_int(np.stack((cell_of[owner], sides), axis=1))
    return Faces(points, keep_offsets, keep_vertices, face_cells, note_repairs(repairs))


def solids_as_csr(cells: Any) -> tuple[Int, Int, Int]:
    """Cell offsets, loop offsets and vertices of cells given as nested lists or as these three."""
    if isinstance(cells, tuple) and len(cells) == 3 and any(isinstance(part, np.ndarray) for part in cells):
        a, b, c = cells
        return whole_numbers(a, "cell offsets"), whole_numbers(b, "face offsets"), whole_numbers(c, "cells")
    try:
        solids = [list(cell) for cell in cells]
        loops = [list(loop) for cell in solids for loop in cell]
        flat = np.array([vertex for loop in loops for vertex in loop])
    except (TypeError, ValueError) as error:
        raise MeshError(f"cells must be lists of faces, each a vertex loop of integers: {error}") from None
    counts, sizes = [len(cell) for cell in solids], [len(loop) for loop in loops]
    return (
        frozen_int(np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))),
        frozen_int(np.concatenate(([0], np.cumsum(sizes, dtype=np.int64)))),
        whole_numbers(flat, "cells"),
    )


def _check_counts(cell_offsets: Int, loop_offsets: Int, vertices: Int) -> None:
    check_offsets(cell_offsets, len(loop_offsets) - 1, "cell")
    check_offsets(loop_offsets, len(vertices), "face")
    if len(cell_offsets) < 2:
        raise MeshError("the mesh is empty: it has no cells")
    few = np.flatnonzero(np.diff(cell_offsets) < 4)
    if len(few):
        raise MeshError(f"{name_cells(few)}: fewer than 4 faces")
    few = np.flatnonzero(np.diff(loop_offsets) < 3)
    if len(few):
        owner = np.searchsorted(cell_offsets, few, side="right") - 1
        raise MeshError(f"{name_cells(np.unique(owner))}: a face with fewer than 3 vertices")


def _refuse_repeats(cell_of: Int, loop_offsets: Int, vertices: Int, n_points: int) -> None:
    from agglo_core.kernels.face_loops import repeated_points

    repeated = repeated_points(loop_offsets, vertices, n_points)
    if repeated.any():
        cells = np.unique(cell_of[repeated])
        raise MeshError(f"{name_cells(cells)}: a face with a repeated vertex")


def _outward(
    cell_of: Int, loop_offsets: Int, vertices: Int, vector: Float, centre: Float, off: float
) -> Float:
    """Sign of each half-face: −1 where its loop as given is clockwise seen from outside.

    Where all faces of a cell look away from its middle, or all look towards it, they are taken as they
    are; elsewhere neighbours across an edge must traverse it in opposite directions. Points that hang on
    an edge may be ``off`` it, so that the tiles of a split face and the faces beside it leave a slit.
    """
    from agglo_core.kernels.solid_cells import surfaces

    offsets = frozen_int(np.concatenate(([0], np.cumsum(np.bincount(cell_of)))))
    area, gap, least, most, total, *middle = surfaces(offsets, vector, centre).T
    alike = (least >= 0) | (most <= 0)
    slit = np.minimum(off * np.sqrt(area), _SLIT * area)
    closed = np.maximum(_CLOSED * area, slit)
    doubtful = np.flatnonzero(~(alike & (gap <= closed))[cell_of])
    sign = np.ones(len(cell_of))
    if len(doubtful):
        cells = cell_of[doubtful]
        arm = centre[doubtful] - np.stack(middle, axis=1)[cells]
        flux = frozen_float((arm * vector[doubtful]).sum(axis=1))
        loops = _take_loops(loop_offsets, vertices, doubtful, np.ones(len(doubtful), bool))
        sign[doubtful] = _consistent(frozen_int(cells), *loops, flux)
        _, gap, _, _, total, *_ = surfaces(offsets, frozen_float(vector * sign[:, None]), centre).T
    broken = np.flatnonzero(gap > closed)
    if len(broken):
        raise MeshError(f"{name_cells(broken)}: the faces do not close, or cannot be oriented")
    flat = np.flatnonzero(np.abs(total) <= 3e-15 * area**1.5)
    if len(flat):
        raise MeshError(f"{name_cells(flat)}: zero volume")
    return frozen_float(sign * np.sign(total)[cell_of])


def _consistent(cell_of: Int, loop_offsets: Int, vertices: Int, flux: Float) -> Float:
    """Signs that make the faces of each cell traverse every edge once in each direction, where possible."""
    loop = np.repeat(np.arange(len(cell_of)), np.diff(loop_offsets))
    head = np.roll(vertices, -1)
    head[loop_offsets[1:] - 1] = vertices[loop_offsets[:-1]]
    low, cell = np.minimum(vertices, head), cell_of[loop]
    edge = low * (vertices.max() + 1) + np.maximum(vertices, head)
    order = np.lexsort((edge, cell))
    step = np.stack((cell, edge))[:, order]
    start = np.flatnonzero(np.concatenate(([True], (np.diff(step, axis=1) != 0).any(axis=0))))
    way = np.where(vertices == low, 1, -1)[order]
    lost = np.add.reduceat(way, start) != 0
    unbalanced = np.zeros(int(cell_of[-1]) + 1, bool)
    unbalanced[step[0, start[lost]]] = True
    pairs = start[np.diff(np.append(start, len(order))) == 2]
    f, g = loop[order[pairs]], loop[order[pairs + 1]]
    shell, side = _two_sides(frozen_int(f), frozen_int(g), way[pairs] == way[pairs + 1], len(cell_of))
    net = np.bincount(shell, weights=side * flux)  # a shell looks outward on the whole
    return frozen_float(np.where(unbalanced[cell_of], side * np.where(net < 0, -1.0, 1.0)[shell], 1.0))


def _two_sides(f: Int, g: Int, clash: NDArray[np.bool_], n: int) -> tuple[Int, Float]:
    """Shell of each of n faces, and the sign that orients it like the shell's first face.

    Faces f and g share an edge; if they ``clash``, one of them must turn. Every face stands for two
    nodes, as given and turned; joining what belongs together leaves the two orientations of a shell.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    turn = n * clash
    rows, columns = np.concatenate((f, f + n)), np.concatenate((g + turn, g + n - turn))
    links = coo_array((np.ones(len(rows)), (rows, columns)), shape=(2 * n, 2 * n))
    component = connected_components(links, directed=False)[1]
    shell = np.minimum(component[:n], component[n:])
    return frozen_int(shell), frozen_float(np.where(component[:n] == shell, 1.0, -1.0))


def _match(cell_of: Int, loop_offsets: Int, vertices: Int, used: Int) -> tuple[Int, Int]:
    """Half-faces paired by vertex set: owner half-face of each face, and its partner or −1."""
    from agglo_core.kernels.solid_cells import pair_half_faces

    found = pair_half_faces(loop_offsets, vertices, len(used))
    owner = np.flatnonzero(found >= -1)
    partner = found[owner]
    if not len(found):
        owner, partner = _sorted_pairs(cell_of, loop_offsets, vertices, used)
    same = np.flatnonzero((partner >= 0) & (cell_of[owner] == cell_of[partner]))
    if len(same):
        raise MeshError(f"{name_cells(np.unique(cell_of[owner[same]]))}: the same face twice")
    return frozen_int(owner), frozen_int(partner)


def _sorted_pairs(cell_of: Int, loop_offsets: Int, vertices: Int, used: Int) -> tuple[Int, Int]:
    """As ``_match``, by sorting; raises MeshError that says why three have the same vertices."""
    sizes = np.diff(loop_offsets)
    owners, partners = [], []
    for size in np.unique(sizes):
        loops = np.flatnonzero(sizes == size)
        keys = np.sort(vertices[loop_offsets[loops][:, None] + np.arange(size)], axis=1)
        order = np.lexsort(keys.T[::-1])  # stable: equal faces stay in the order of their cells
        new = np.concatenate(([True], (np.diff(keys[order], axis=0) != 0).any(axis=1)))
        start = np.flatnonzero(new)
        count = np.diff(np.append(start, len(order)))
        many = np.flatnonzero(count > 2)
        if len(many):
            half_faces = loops[order[start[many[0]] : start[many[0]] + count[many[0]]]]
            face = used[keys[order[start[many[0]]]]].tolist()
            _refuse_shared_face(cell_of, loop_offsets, vertices, cell_of[half_faces].tolist(), face)
        owners.append(loops[order[start]])
        partners.append(np.where(count == 2, loops[order[np.minimum(start + 1, len(order) - 1)]], -1))
    owner, partner = np.concatenate(owners), np.concatenate(partners)
    order = np.argsort(owner)
    return owner[order], partner[order]


def _refuse_shared_face(
    cell_of: Int, loop_offsets: Int, vertices: Int, cells: list[int], face: list[int]
) -> NoReturn:
    """Raise MeshError that says why a face cannot have these three or more cells."""
    for cell in cells:
        if cells.count(cell) > 1:
            raise MeshError(f"cell {cell}: the same face twice")
    loops = np.searchsorted(cell_of, [[cell, cell + 1] for cell in cells])
    sets = [np.unique(vertices[loop_offsets[i] : loop_offsets[j]]) for i, j in loops]
    for (a, own), (b, others) in combinations(zip(cells, sets, strict=True), 2):
        if np.array_equal(own, others):
            raise MeshError(f"cells {a} and {b} are duplicates: they have the same vertices")
    raise MeshError(
        f"the face with points {face} has more than two cells: cells {', '.join(map(str, cells))}"
    )


def _refuse_overlaps(cell_of: Int, owner: Int, partner: Int, outward: Float) -> None:
    """Two cells must lie on different sides of the face they share."""
    inner = partner >= 0
    a, b = owner[inner], partner[inner]
    wrong = np.flatnonzero((outward[a] * outward[b]).sum(axis=1) > 0)
    if not len(wrong):
        return
    first, second = int(cell_of[a[wrong[0]]]), int(cell_of[b[wrong[0]]])
    pair = (np.minimum(cell_of[a], cell_of[b]) == first) & (np.maximum(cell_of[a], cell_of[b]) == second)
    if pair.sum() == (cell_of == first).sum() == (cell_of == second).sum():
        raise MeshError(f"cells {first} and {second} are duplicates: they have the same faces")
    raise MeshError(f"cells {first} and {second} overlap: both lie on the same side of a face")


def _take_loops(offsets: Int, vertices: Int, loops: Int, forward: Any) -> tuple[Int, Int]:
    sizes = np.diff(offsets)[loops]
    new = np.concatenate(([0], np.cumsum(sizes)))
    rank = np.arange(new[-1]) - np.repeat(new[:-1], sizes)
    mirrored = np.repeat(sizes, sizes) - 1 - rank
    rank = np.where(np.repeat(forward, sizes), rank, mirrored)
    return frozen_int(new), frozen_int(vertices[np.repeat(offsets[loops], sizes) + rank])
