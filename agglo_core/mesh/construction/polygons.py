"""Build the faces of a 2-D mesh from polygons, count repairs, and report faulty cells."""

from __future__ import annotations

from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int, is_masked_array
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import (
    box_centre,
    check_extent,
    check_finite,
    check_indices,
    check_offsets,
    check_points,
    compact_points,
    name_cells,
    note_repairs,
    whole_numbers,
)
from agglo_core.mesh.construction.polygon_faces import polygon_faces
from agglo_core.mesh.construction.repeated_vertices import simple_loops
from agglo_core.mesh.elements import gather

_REPEATED, _ZERO = 1, 2  # codes of kernels.polygon_faults
# descriptions of faults, by the codes of kernels.polygon_faults
_FAULTS = {
    _REPEATED: "a repeated vertex",
    3: "a boundary that crosses itself (bow-tie)",
    4: "a boundary that folds back on itself",
}
_CELL_ARRAY = "pass a cell array of MATLAB as [np.ravel(cell).astype(int) - 1 for cell in cells.ravel()]"


class Faces(NamedTuple):
    """Arrays of a checked :class:`~agglo_core.mesh.Mesh`, and the repair count per kind."""

    points: Float
    face_offsets: Int
    face_vertices: Int
    face_cells: Int
    repairs: dict[str, int]


def loops_as_csr(cells: Any) -> tuple[Int, Int]:
    """Convert vertex loops to CSR, from a list, an ``(n, k)`` array, or offsets and vertices.

    Masked entries at the end of a row are padding, as in UGRID files.
    """
    if isinstance(cells, tuple) and len(cells) == 2 and any(isinstance(part, np.ndarray) for part in cells):
        return whole_numbers(cells[0], "cell offsets"), whole_numbers(cells[1], "cells")
    # Padded rows: a mask.
    if is_masked_array(cells) and cells.ndim == 2:
        is_vertex = ~np.ma.getmaskarray(cells)
        gaps = np.flatnonzero((~is_vertex[:, :-1] & is_vertex[:, 1:]).any(axis=1))
        if len(gaps):
            raise MeshError(f"{name_cells(gaps)}: masked vertices must be at the end of the row")
        offsets = np.concatenate(([0], np.cumsum(is_vertex.sum(axis=1))))
        return frozen_int(offsets), whole_numbers(cells.data[is_vertex], "cells")
    if isinstance(cells, np.ndarray) and cells.ndim == 2:
        if cells.dtype == object:
            raise MeshError(f"cells is an array {cells.shape} of objects: {_CELL_ARRAY}")
        n, k = cells.shape
        return frozen_int(np.arange(n + 1) * k), whole_numbers(cells.ravel(), "cells")
    # A sequence of loops.
    try:
        loops = [drop_padding(loop) for loop in cells]
        sizes = [len(loop) for loop in loops]
        flat: Any
        if loops and isinstance(loops[0], np.ndarray):
            if loops[0].ndim != 1:
                raise MeshError(f"cell 0 has shape {loops[0].shape}, expected (k,): {_CELL_ARRAY}")
            flat = np.concatenate(loops)
        else:
            flat = list(chain.from_iterable(loops))
    except (TypeError, ValueError) as error:
        raise MeshError(f"cells must be vertex loops of integers: {error}") from None
    return frozen_int(np.concatenate(([0], np.cumsum(sizes, dtype=np.int64)))), whole_numbers(flat, "cells")


def drop_padding(loop: Any) -> Any:
    """Remove masked entries (padding) from the end of a vertex loop.

    Raises MeshError for other masked vertices.
    """
    if not is_masked_array(loop) or loop.ndim != 1:
        return loop
    vertices = loop.compressed()
    if loop[: len(vertices)].mask.any():
        raise MeshError(f"masked vertices must be at the end of a loop, given {loop.tolist()}")
    return vertices


def _plane(points: Float) -> Float:
    """Return the points as ``(n, 2)``, after removal of a constant z coordinate.

    Raises MeshError for a surface in 3-D.
    """
    if points.shape[1] == 2:
        return points
    z = points[:, 2]
    if len(z) and np.ptp(z) > 0 and np.ptp(z) > 1e-12 * max(np.ptp(points, axis=0).max(), np.abs(z).max()):
        raise MeshError(
            f"polygons in 3-D are a surface, which is not supported: z runs from {z.min():g} to "
            f"{z.max():g}; give two coordinates, or a constant z"
        )
    return frozen_float(points[:, :2])


def build_polygons(
    points: ArrayLike, cells: Any, merge_points: bool, weak: bool, strict: bool, drop_flat: bool
) -> tuple[Faces, Int, int]:
    """Build faces from polygons given as vertex loops.

    Return them, the kept cells, and the number of given cells.

    Arguments and errors are those of ``Mesh.from_polygons``.
    """
    # Check the arrays.
    offsets, vertices = loops_as_csr(cells)
    points = check_points(points)
    check_offsets(offsets, len(vertices), "cell")
    n = len(offsets) - 1
    if n < 1:
        raise MeshError("the mesh is empty: it has no cells")
    few = np.flatnonzero(np.diff(offsets) < 3)
    if len(few):
        raise MeshError(f"{name_cells(few)}: fewer than 3 vertices")
    check_indices(offsets, vertices, len(points))
    check_finite(points, vertices)
    # Drop unused points, check the coordinates, orient the loops.
    used_points, vertices, repairs = compact_points(points, vertices, merge_points)
    points = _plane(points if len(used_points) == len(points) else frozen_float(points[used_points]))
    check_extent(points)
    cell_numbers, offsets, vertices, simplified, reversed_ = _orient_loops(
        points, offsets, vertices, weak, drop_flat
    )
    repairs["cells with repeated vertices simplified"] = simplified
    repairs["cells without area dropped"] = n - len(cell_numbers)
    repairs["clockwise cells reversed"] = reversed_
    if len(cell_numbers) < n:  # some points belong to dropped cells only
        remaining, vertices, later_repairs = compact_points(points, vertices, False)
        used_points, points = used_points[remaining], frozen_float(points[remaining])
        repairs["orphan points dropped"] += later_repairs["orphan points dropped"]
    # Pair the half-edges.
    face_vertices, face_cells, overlaps = polygon_faces(
        offsets, vertices, used_points, cell_numbers, weak=weak, strict=strict
    )
    repairs["overlapping edges left apart"] = overlaps
    if strict:
        _check_coverage(points, offsets, vertices, cell_numbers)
    faces = Faces(
        points,
        frozen_int(np.arange(0, 2 * len(face_cells) + 1, 2)),
        frozen_int(face_vertices.ravel()),
        face_cells,
        note_repairs(repairs),
    )
    return faces, cell_numbers, n


def drop_flat_cells(flat: Mask, measure: str, drop_flat: bool, own: Int | None = None) -> Int:
    """Return the indices of the cells that are not flat, that is, of nonzero area or volume.

    Parameters
    ----------
    flat : (n,) bool
    measure : str
        Area or volume, for the message.
    drop_flat : bool
        Accept flat cells, and drop them.
    own : (n,) int, optional
        Cell numbers in messages, if not 0, 1, ….

    Raises
    ------
    MeshError
        For flat cells, unless they may be dropped and other cells remain.
    """
    if flat.any() and not drop_flat:
        cells = np.flatnonzero(flat)
        named = name_cells(cells if own is None else own[cells])
        raise MeshError(f"{named}: zero {measure}; drop_flat=True leaves such cells out")
    if flat.all():
        raise MeshError(f"the mesh is empty: all {len(flat)} cells have zero {measure}")
    return frozen_int(np.flatnonzero(~flat))


def _orient_loops(
    points: Float, offsets: Int, vertices: Int, weak: bool, drop_flat: bool
) -> tuple[Int, Int, Int, int, int]:
    """Orient the loops counter-clockwise and remove cells without area.

    Return kept cells, loops, and the numbers of simplified and reversed cells.
    """
    from agglo_core.mesh.kernels.polygon_faults import check_polygons

    local, simplified = frozen_float(points - box_centre(points)), 0
    cell_numbers = frozen_int(np.arange(len(offsets) - 1))
    area, fault = check_polygons(local, offsets, vertices, weak)
    # Remove repeated vertices, then cells without area.
    if (fault == _REPEATED).any():
        sizes, (offsets, vertices) = np.diff(offsets), simple_loops(offsets, vertices)
        simplified = int((np.diff(offsets) < sizes).sum())
        cell_numbers = drop_flat_cells(np.diff(offsets) < 3, "area", drop_flat)
        offsets, places = gather(offsets, cell_numbers)
        vertices = frozen_int(vertices[places])
        area, fault = check_polygons(local, offsets, vertices, weak)
    if (fault == _ZERO).any():
        full = drop_flat_cells(fault == _ZERO, "area", drop_flat, cell_numbers)
        cell_numbers, area, fault = cell_numbers[full], area[full], fault[full]
        offsets, places = gather(offsets, full)
        vertices = frozen_int(vertices[places])
    if fault.any():
        code = int(fault[np.argmax(fault > 0)])
        raise MeshError(f"{name_cells(cell_numbers[fault == code])}: {_FAULTS[code]}")
    # Reverse clockwise loops.
    clockwise = area < 0
    count = int(clockwise.sum())
    if count:
        sizes = np.diff(offsets)
        position = np.arange(len(vertices))
        mirrored = np.repeat(offsets[:-1] + offsets[1:] - 1, sizes) - position
        vertices = frozen_int(vertices[np.where(np.repeat(clockwise, sizes), mirrored, position)])
    return cell_numbers, offsets, vertices, simplified, count


def _check_coverage(points: Float, offsets: Int, vertices: Int, cell_numbers: Int) -> None:
    """Raise MeshError if cells overlap, or an edge contains a neighbour's vertex."""
    import shapely

    centre = box_centre(points)
    rings = shapely.linearrings(
        (points - centre)[_close_loops(offsets, vertices)],
        indices=np.repeat(np.arange(len(offsets) - 1), np.diff(offsets) + 1),
    )
    wrong = shapely.coverage_invalid_edges(shapely.polygons(rings))
    cells = np.flatnonzero(~shapely.is_empty(wrong))
    if len(cells):
        a, b = (shapely.get_coordinates(wrong[cells[0]])[:2] + centre).tolist()
        raise MeshError(
            f"{name_cells(cell_numbers[cells])} overlap a neighbour or touch it at an unlisted vertex, "
            f"first along the edge from {a} to {b} of cell {cell_numbers[cells[0]]}"
        )


def _close_loops(offsets: Int, vertices: Int) -> Int:
    """Return the vertices of loops that end with their first vertex, from loops without it."""
    return frozen_int(np.insert(vertices, offsets[1:], vertices[offsets[:-1]]))
