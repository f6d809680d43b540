"""From polygons as given to a checked 2-D Mesh: repairs are counted, faults name their cells."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh, box_centre

__all__ = [
    "build_polygons",
    "check_indices",
    "check_offsets",
    "check_points",
    "compact_points",
    "name_cells",
    "note_repairs",
    "whole_numbers",
]

_log = logging.getLogger("agglo")
_FAULTS = {  # by the codes of kernels.faces
    1: "a repeated vertex",
    2: "zero area",
    3: "a boundary that crosses itself (bow-tie)",
    4: "a boundary that folds back on itself",
}


def name_cells(cells: ArrayLike) -> str:
    """``cell 3`` or ``cells 3, 8, 12, … (40 in all)`` for messages."""
    array = np.atleast_1d(cells)
    shown = ", ".join(str(int(cell)) for cell in array[:5])
    if len(array) == 1:
        return f"cell {shown}"
    return f"cells {shown}" + (f", … ({len(array)} in all)" if len(array) > 5 else "")


def check_points(points: ArrayLike) -> Float:
    """Finite ``(n, 2 or 3)`` float copy, or MeshError naming the point."""
    try:
        array = frozen_float(np.array(points, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise MeshError(f"points must be numbers of shape (n_points, d): {error}") from None
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise MeshError(f"points must have shape (n_points, 2) or (n_points, 3), not {array.shape}")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise MeshError(f"point {bad[0]} is not finite: {array[bad[0]].tolist()} ({len(bad)} such points)")
    return array


def check_offsets(offsets: Int, total: int, what: str) -> None:
    """Raise MeshError unless offsets rise from 0 to ``total``."""
    if len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != total or (np.diff(offsets) < 0).any():
        raise MeshError(f"{what} offsets must rise from 0 to {total}, the number of entries they cut")


def check_indices(offsets: Int, vertices: Int, n_points: int) -> None:
    """Raise MeshError unless every vertex of cell c, ``offsets[c]:offsets[c + 1]``, is in 0..n_points−1."""
    bad = np.flatnonzero((vertices < 0) | (vertices >= n_points))
    if len(bad):
        owner = int(np.searchsorted(offsets, bad[0], side="right")) - 1
        raise MeshError(f"cell {owner} uses point {vertices[bad[0]]}, but there are {n_points} points")


def compact_points(points: Float, vertices: Int, merge: bool) -> tuple[Int, Int, dict[str, int]]:
    """Numbers of the points in use (equal ones merged if asked), vertices renumbered to them, repairs."""
    merged = 0
    if merge:
        vertices, merged = _merge_equal(points, vertices)
    used = np.zeros(len(points), bool)
    used[vertices] = True
    kept = int(used.sum())
    repairs = {"equal points merged": merged, "orphan points dropped": len(points) - kept - merged}
    number = np.cumsum(used) - 1
    renumbered = vertices if kept == len(points) else frozen_int(number[vertices])
    return frozen_int(np.flatnonzero(used)), renumbered, repairs


def _merge_equal(points: Float, vertices: Int) -> tuple[Int, int]:
    """Vertices renumbered so that exactly equal points are one; and how many points that makes unused."""
    points = points + 0.0  # -0.0 equals 0.0
    order = np.lexsort(points.T)
    new = np.concatenate(([True], (np.diff(points[order], axis=0) != 0).any(axis=1)))
    first = np.minimum.reduceat(order, np.flatnonzero(new))
    target = np.empty(len(points), np.int64)
    target[order] = first[np.cumsum(new) - 1]
    return frozen_int(target[vertices]), len(points) - len(first)


def note_repairs(repairs: Mapping[str, int]) -> dict[str, int]:
    """The repairs that happened, each logged."""
    found = {text: count for text, count in repairs.items() if count}
    for text, count in found.items():
        _log.info("%s: %d", text, count)
    return found


def whole_numbers(values: Any, what: str) -> Int:
    """One-dimensional integers, or MeshError."""
    array = np.asarray(values)
    if array.size and array.dtype.kind not in "iu":
        raise MeshError(f"{what} must hold integers, not {array.dtype}")
    if array.ndim != 1:
        raise MeshError(f"{what} must be one-dimensional, not of shape {array.shape}")
    return frozen_int(array)


def _as_csr(cells: Any) -> tuple[Int, Int]:
    """Offsets and vertices of loops given as a list, an (n, k) array or such a pair."""
    if isinstance(cells, tuple) and len(cells) == 2 and any(isinstance(part, np.ndarray) for part in cells):
        return whole_numbers(cells[0], "cell offsets"), whole_numbers(cells[1], "cells")
    if isinstance(cells, np.ndarray) and cells.ndim == 2:
        n, k = cells.shape
        return frozen_int(np.arange(n + 1) * k), whole_numbers(cells.ravel(), "cells")
    try:
        loops = list(cells)
        sizes = [len(loop) for loop in loops]
        arrays = bool(loops) and isinstance(loops[0], np.ndarray)
        flat = np.concatenate(loops) if arrays else np.array(list(chain.from_iterable(loops)))
    except (TypeError, ValueError) as error:
        raise MeshError(f"cells must be vertex loops of integers: {error}") from None
    return frozen_int(np.concatenate(([0], np.cumsum(sizes, dtype=np.int64)))), whole_numbers(flat, "cells")


def _plane(points: Float) -> Float:
    if points.shape[1] == 2:
        return points
    z = points[:, 2]
    if len(z) and np.ptp(z) > 1e-12 * max(np.ptp(points, axis=0).max(), np.abs(z).max()):
        raise MeshError(
            f"polygons in 3-D are a surface, which is not supported: z runs from {z.min():g} to "
            f"{z.max():g}; give two coordinates, or a constant z"
        )
    return frozen_float(points[:, :2])


def build_polygons(
    points: ArrayLike,
    cells: Any,
    cell_tags: Mapping[str, ArrayLike],
    merge_points: bool,
    weak: bool,
    strict: bool,
    name: str,
) -> Mesh:
    """What :meth:`Mesh.from_polygons` does."""
    offsets, vertices = _as_csr(cells)
    points = check_points(points)
    check_offsets(offsets, len(vertices), "cell")
    if len(offsets) < 2:
        raise MeshError("the mesh is empty: it has no cells")
    few = np.flatnonzero(np.diff(offsets) < 3)
    if len(few):
        raise MeshError(f"{name_cells(few)}: fewer than 3 vertices")
    check_indices(offsets, vertices, len(points))
    used, vertices, repairs = compact_points(points, vertices, merge_points)
    points = _plane(points if len(used) == len(points) else frozen_float(points[used]))
    local = frozen_float(points - box_centre(points))
    vertices, repairs["clockwise cells reversed"] = _orient(local, offsets, vertices, weak)
    face_vertices, face_cells, overlaps = _faces(offsets, vertices, used, weak, strict)
    repairs["overlapping edges left apart"] = overlaps
    mesh = Mesh(
        points=points,
        face_offsets=frozen_int(np.arange(0, 2 * len(face_cells) + 1, 2)),
        face_vertices=face_vertices.ravel(),
        face_cells=face_cells,
        cell_tags={key: np.array(values) for key, values in cell_tags.items()},
        repairs=note_repairs(repairs),
        name=name,
    )
    if strict:
        _check_coverage(mesh, offsets, vertices)
    return mesh


def _orient(local: Float, offsets: Int, vertices: Int, weak: bool) -> tuple[Int, int]:
    """Vertices with every loop counter-clockwise, and the number of loops reversed."""
    from agglo_core.kernels.faces import check_polygons

    area, fault = check_polygons(local, offsets, vertices, weak)
    if fault.any():
        code = int(fault[np.argmax(fault > 0)])
        raise MeshError(f"{name_cells(np.flatnonzero(fault == code))}: {_FAULTS[code]}")
    clockwise = area < 0
    if not clockwise.any():
        return vertices, 0
    sizes = np.diff(offsets)
    position = np.arange(len(vertices))
    mirrored = np.repeat(offsets[:-1] + offsets[1:] - 1, sizes) - position
    return frozen_int(vertices[np.where(np.repeat(clockwise, sizes), mirrored, position)]), int(
        clockwise.sum()
    )


def _faces(offsets: Int, vertices: Int, used: Int, weak: bool, strict: bool) -> tuple[Int, Int, int]:
    """Face vertices, face cells, and how many pairs of cells overlap at an edge."""
    from agglo_core.kernels.faces import match_half_edges

    face_vertices, face_cells, double, (a, b, *cells) = match_half_edges(offsets, vertices, len(used))
    if a >= 0:
        _refuse_twins(offsets, vertices, combinations(cells, 2))
        named = ", ".join(str(cell) for cell in sorted(cells))
        raise MeshError(
            f"the face between points {used[a]} and {used[b]} has more than two cells: cells {named}"
        )
    if weak:  # an agglomerate of two overlapping cells walks their common edge twice
        double = double[double[:, 0] != double[:, 1]]
    _refuse_twins(offsets, vertices, double.tolist())
    for first, second in double.tolist():
        if strict:
            raise MeshError(f"cells {first} and {second} overlap: both lie on the same side of an edge")
    return frozen_int(face_vertices), frozen_int(face_cells), len(double)


def _refuse_twins(offsets: Int, vertices: Int, pairs: Iterable[Sequence[int]]) -> None:
    """Raise MeshError if a pair of cells is one cell twice, or a cell walks an edge twice."""
    for first, second in pairs:
        if first == second:
            raise MeshError(f"cell {first}: a repeated vertex (it walks an edge twice)")
        a, b = (np.sort(vertices[offsets[c] : offsets[c + 1]]) for c in (first, second))
        if np.array_equal(a, b):
            raise MeshError(f"cells {first} and {second} are duplicates: they have the same vertices")


def _check_coverage(mesh: Mesh, offsets: Int, vertices: Int) -> None:
    """Strict check: no two cells overlap, no vertex hangs on a neighbour's edge without being listed."""
    import shapely

    rings = shapely.linearrings(
        mesh.local_points[_closed(offsets, vertices)],
        indices=np.repeat(np.arange(len(offsets) - 1), np.diff(offsets) + 1),
    )
    wrong = shapely.coverage_invalid_edges(shapely.polygons(rings))
    cells = np.flatnonzero(~shapely.is_empty(wrong))
    if len(cells):
        a, b = (shapely.get_coordinates(wrong[cells[0]])[:2] + mesh.origin).tolist()
        raise MeshError(
            f"{name_cells(cells)} overlap a neighbour or touch it at an unlisted vertex, "
            f"first along the edge from {a} to {b} of cell {cells[0]}"
        )


def _closed(offsets: Int, vertices: Int) -> Int:
    """Vertices of each loop with the first repeated at the end."""
    return frozen_int(np.insert(vertices, offsets[1:], vertices[offsets[:-1]]))
