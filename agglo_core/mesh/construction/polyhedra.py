"""Build the faces of a 3-D mesh from polyhedra: orient, pair and check their half-faces."""

from __future__ import annotations

from itertools import combinations
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, Mask, frozen, frozen_float, frozen_int
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
from agglo_core.mesh.construction.polygons import Faces, drop_flat_cells, drop_padding
from agglo_core.mesh.construction.repeated_vertices import simple_solids
from agglo_core.mesh.construction.shells import outward_signs, signs_of_plain_cells
from agglo_core.mesh.elements import Polyhedra, take_cells
from agglo_core.mesh.geometry.solid_cells import face_moments

_ROUNDING = 8  # units in the last place by which points may be off the edge or face that contains them


def build_polyhedra(
    points: ArrayLike, cells: Any, merge_points: bool, drop_flat: bool
) -> tuple[Faces, Int, int]:
    """Build faces from polyhedra given by the vertex loops of their faces.

    Return them, the kept cells, and the number of given cells.

    Arguments and errors are those of ``Mesh.from_polyhedra``.
    """
    # Check the arrays.
    points = check_points(points)
    if points.shape[1] != 3:
        raise MeshError(f"polyhedra need points of shape (n_points, 3), not {points.shape}")
    solids = Polyhedra(*solids_as_csr(cells))
    n = len(solids.cell_offsets) - 1
    _check_counts(solids)
    check_indices(solids.loop_offsets[solids.cell_offsets], solids.vertices, len(points))
    check_finite(points, solids.vertices)
    # Drop unused points and repeated vertices, then turn the faces outward.
    used_points, vertices, repairs = compact_points(points, solids.vertices, merge_points)
    solids, repairs["cells with repeated vertices simplified"] = _simple(
        solids._replace(vertices=vertices), len(used_points)
    )
    points = frozen_float(points[used_points])
    check_extent(points)
    local = frozen_float(points - box_centre(points))  # to limit rounding
    cell_numbers, solids, sign = _orient_half_faces(local, solids, drop_flat, _ROUNDING * last_place(points))
    repairs["cells without volume dropped"] = n - len(cell_numbers)
    repairs["faces turned outward"] = int((sign < 0).sum())
    # Pair the half-faces.
    loop_offsets, vertices = solids.loop_offsets, solids.vertices
    cell_of = frozen_int(np.repeat(cell_numbers, np.diff(solids.cell_offsets)))
    owner, neighbour = _match(cell_of, loop_offsets, vertices, used_points)
    sides = np.empty((len(owner), 2), np.int64)
    sides[:, 0] = cell_of[owner]
    sides[:, 1] = np.where(neighbour >= 0, cell_of[neighbour], -1)
    doubled = np.flatnonzero(sides[:, 0] == sides[:, 1])
    if len(doubled):
        raise MeshError(f"{name_cells(np.unique(sides[doubled, 0]))}: the same face twice")
    _refuse_overlaps(cell_of, owner, neighbour, local, loop_offsets, vertices, sign)
    keep_offsets, keep_vertices = _take_loops(loop_offsets, vertices, owner, sign[owner] > 0)
    if len(cell_numbers) < n:  # renumber the cells and drop the points of removed cells
        sides = np.where(sides >= 0, np.searchsorted(cell_numbers, sides), -1)
        remaining, keep_vertices, later_repairs = compact_points(points, keep_vertices, False)
        points = frozen_float(points[remaining])
        repairs["orphan points dropped"] += later_repairs["orphan points dropped"]
    face_cells = frozen_int(sides)
    return Faces(points, keep_offsets, keep_vertices, face_cells, note_repairs(repairs)), cell_numbers, n


def _orient_half_faces(
    points: Float, solids: Polyhedra, drop_flat: bool, off: float
) -> tuple[Int, Polyhedra, Float]:
    """Drop cells without volume, and find the signs that turn the other half-faces outward.

    Points may be ``off`` from edges that contain them. Return kept cells, their half-faces, and the signs.
    """
    cell_numbers = drop_flat_cells(np.diff(solids.cell_offsets) == 0, "volume", drop_flat)
    if len(cell_numbers) < len(solids.cell_offsets) - 1:
        solids = take_cells(solids, cell_numbers)
    _check_counts(solids, cell_numbers)
    sign = signs_of_plain_cells(solids, points, off)
    if sign is not None:
        return cell_numbers, solids, sign
    # Some cells need more than one pass over their faces.
    vector, centre = face_moments(points, solids.loop_offsets, solids.vertices)
    cell_of = frozen_int(np.repeat(np.arange(len(cell_numbers)), np.diff(solids.cell_offsets)))
    sign, open_cells, flat = outward_signs(
        cell_of, solids.loop_offsets, solids.vertices, points, vector, centre, off
    )
    if len(open_cells):
        raise MeshError(
            f"{name_cells(cell_numbers[open_cells])}: the faces do not close, or cannot be oriented"
        )
    if not flat.any():
        return cell_numbers, solids, sign
    # Drop cells without volume and their half-faces.
    full = drop_flat_cells(flat, "volume", drop_flat, cell_numbers)
    return cell_numbers[full], take_cells(solids, full), frozen_float(sign[~flat[cell_of]])


def _simple(solids: Polyhedra, n_points: int) -> tuple[Polyhedra, int]:
    """Remove consecutive repeats of a vertex from face loops, and count the changed cells.

    Raises MeshError for a face that returns to a vertex.
    """
    from agglo_core.mesh.kernels.face_loops import loops_with_repeats

    if not loops_with_repeats(solids.loop_offsets, solids.vertices, n_points).any():
        return solids, 0
    simple = simple_solids(solids)
    repeated = loops_with_repeats(simple.loop_offsets, simple.vertices, n_points)
    if repeated.any():
        cells = np.searchsorted(simple.cell_offsets, np.flatnonzero(repeated), side="right") - 1
        raise MeshError(f"{name_cells(np.unique(cells))}: a face with a repeated vertex")
    length, simple_length = (np.diff(each.loop_offsets[each.cell_offsets]) for each in (solids, simple))
    return simple, int((simple_length < length).sum())


def solids_as_csr(cells: Any) -> tuple[Int, Int, Int]:
    """Convert polyhedra to cell offsets, face offsets and vertices.

    The cells are given as nested lists, or already as these three arrays.
    """
    if isinstance(cells, tuple) and len(cells) == 3 and any(isinstance(part, np.ndarray) for part in cells):
        a, b, c = cells
        return whole_numbers(a, "cell offsets"), whole_numbers(b, "face offsets"), whole_numbers(c, "cells")
    try:
        solids = [list(cell) for cell in cells]
        loops = [list(drop_padding(loop)) for cell in solids for loop in cell]
        flat = [vertex for loop in loops for vertex in loop]
    except (TypeError, ValueError) as error:
        raise MeshError(f"cells must be lists of faces, each a vertex loop of integers: {error}") from None
    counts, sizes = [len(cell) for cell in solids], [len(loop) for loop in loops]
    return (
        frozen_int(np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))),
        frozen_int(np.concatenate(([0], np.cumsum(sizes, dtype=np.int64)))),
        whole_numbers(flat, "cells"),
    )


def _check_counts(solids: Polyhedra, numbers: Int | None = None) -> None:
    """Raise MeshError for an empty mesh, cells with few faces, or faces with few vertices.

    ``numbers`` are cell numbers in messages.
    """
    cell_offsets, loop_offsets, vertices = solids
    check_offsets(cell_offsets, len(loop_offsets) - 1, "cell")
    check_offsets(loop_offsets, len(vertices), "face")
    if len(cell_offsets) < 2:
        raise MeshError("the mesh is empty: it has no cells")
    too_small = np.flatnonzero(np.diff(cell_offsets) < 4)
    if len(too_small):
        raise MeshError(
            f"{name_cells(too_small if numbers is None else numbers[too_small])}: fewer than 4 faces"
        )
    too_small = np.flatnonzero(np.diff(loop_offsets) < 3)
    if len(too_small):
        owner = np.searchsorted(cell_offsets, too_small, side="right") - 1
        raise MeshError(f"{name_cells(np.unique(owner))}: a face with fewer than 3 vertices")


def _match(cell_of: Int, loop_offsets: Int, vertices: Int, used_points: Int) -> tuple[Int, Int]:
    """Pair half-faces with the same vertex set into faces.

    Return each face's owner half-face, and its partner or −1.
    """
    from agglo_core.mesh.kernels.solid_cells import pair_half_faces

    if len(cell_of) > np.iinfo(np.int32).max:
        raise MeshError(f"the cells have {len(cell_of)} faces, more than 2^31 - 1")
    partners = pair_half_faces(loop_offsets, vertices, len(used_points))
    owner = np.flatnonzero(partners >= -1)
    partner = partners[owner]
    if not len(partners):
        owner, partner = _pair_by_sorting(cell_of, loop_offsets, vertices, used_points)
    return frozen_int(owner), frozen_int(partner)


def _pair_by_sorting(cell_of: Int, loop_offsets: Int, vertices: Int, used_points: Int) -> tuple[Int, Int]:
    """Pair half-faces by sorting, or raise MeshError where three have equal vertices.

    Raises MeshError with the reason if three half-faces have equal vertices.
    """
    sizes = np.diff(loop_offsets)
    owners, partners = [], []
    for size in np.unique(sizes):
        loops = np.flatnonzero(sizes == size)
        keys = np.sort(vertices[loop_offsets[loops][:, None] + np.arange(size)], axis=1)
        order = np.lexsort(keys.T[::-1])  # stable: equal faces stay in cell order
        new = np.concatenate(([True], (np.diff(keys[order], axis=0) != 0).any(axis=1)))
        start = np.flatnonzero(new)
        count = np.diff(np.append(start, len(order)))
        crowded = np.flatnonzero(count > 2)
        if len(crowded):
            half_faces = loops[order[start[crowded[0]] : start[crowded[0]] + count[crowded[0]]]]
            face = used_points[keys[order[start[crowded[0]]]]].tolist()
            _refuse_shared_face(cell_of, loop_offsets, vertices, cell_of[half_faces].tolist(), face)
        owners.append(loops[order[start]])
        partners.append(np.where(count == 2, loops[order[np.minimum(start + 1, len(order) - 1)]], -1))
    owner, partner = np.concatenate(owners), np.concatenate(partners)
    order = np.argsort(owner)
    return owner[order], partner[order]


def _refuse_shared_face(
    cell_of: Int, loop_offsets: Int, vertices: Int, cells: list[int], face: list[int]
) -> NoReturn:
    """Raise MeshError with the reason why three or more cells list the same face."""
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


def _refuse_overlaps(
    cell_of: Int, owner: Int, partner: Int, points: Float, offsets: Int, vertices: Int, sign: Float
) -> None:
    """Raise MeshError if two cells lie on the same side of their common face."""
    from agglo_core.mesh.kernels.face_loops import first_overlap

    face = first_overlap(owner, partner, points, offsets, vertices, sign)
    if face < 0:
        return
    inner = partner >= 0
    a, b = owner[inner], partner[inner]
    first, second = int(cell_of[owner[face]]), int(cell_of[partner[face]])
    pair = (np.minimum(cell_of[a], cell_of[b]) == first) & (np.maximum(cell_of[a], cell_of[b]) == second)
    if pair.sum() == (cell_of == first).sum() == (cell_of == second).sum():
        raise MeshError(f"cells {first} and {second} are duplicates: they have the same faces")
    raise MeshError(f"cells {first} and {second} overlap: both lie on the same side of a face")


def _take_loops(offsets: Int, vertices: Int, loops: Int, forward: Mask) -> tuple[Int, Int]:
    """Return selected loops, each as listed or in reverse order."""
    from agglo_core.mesh.kernels.face_loops import take_loops

    new_offsets = np.zeros(len(loops) + 1, np.int64)
    np.cumsum(offsets[loops + 1] - offsets[loops], out=new_offsets[1:])
    new_vertices = np.empty(new_offsets[-1], np.int64)
    take_loops(offsets, vertices, loops, frozen(forward, np.bool_), frozen_int(new_offsets), new_vertices)
    return frozen_int(new_offsets), frozen_int(new_vertices)
