"""From polygons as given to a checked 2-D Mesh: repairs are counted, faults name their cells."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh

__all__ = ["build_polygons", "check_indices", "check_points", "drop_orphans", "merge_equal", "name_cells"]

_log = logging.getLogger("agglo")
_FAULTS = {
    1: "fewer than 3 vertices",
    2: "a repeated vertex",
    3: "zero area",
    4: "a boundary that crosses itself (bow-tie)",
}


def name_cells(cells: ArrayLike) -> str:
    """``cell 3`` or ``cells 3, 8, 12, … (40 in all)`` for messages."""
    array = np.atleast_1d(cells)
    shown = ", ".join(str(int(cell)) for cell in array[:5])
    if len(array) == 1:
        return f"cell {shown}"
    return f"cells {shown}" + (f", … ({len(array)} in all)" if len(array) > 5 else "")


def check_points(points: ArrayLike) -> Float:
    """Finite ``(n, 2 or 3)`` float array, or MeshError naming the point."""
    try:
        array = frozen_float(points)
    except (TypeError, ValueError) as error:
        raise MeshError(f"points must be numbers of shape (n_points, d): {error}") from None
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise MeshError(f"points must have shape (n_points, 2) or (n_points, 3), not {array.shape}")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if len(bad):
        raise MeshError(f"point {bad[0]} is not finite: {array[bad[0]].tolist()} ({len(bad)} such points)")
    return array


def check_indices(offsets: Int, vertices: Int, n_points: int, what: str) -> None:
    """Raise MeshError unless every vertex index is in 0..n_points−1."""
    bad = np.flatnonzero((vertices < 0) | (vertices >= n_points))
    if len(bad):
        owner = int(np.searchsorted(offsets, bad[0], side="right")) - 1
        raise MeshError(f"{what} {owner} uses point {vertices[bad[0]]}, but there are {n_points} points")


def merge_equal(points: Float, vertices: Int) -> tuple[Int, int]:
    """Vertices renumbered so that exactly equal points are one; and how many points went."""
    points = points + 0.0  # -0.0 equals 0.0
    order = np.lexsort(points.T)
    new = np.concatenate(([True], (np.diff(points[order], axis=0) != 0).any(axis=1)))
    first = np.minimum.reduceat(order, np.flatnonzero(new))
    target = np.empty(len(points), np.int64)
    target[order] = first[np.cumsum(new) - 1]
    return frozen_int(target[vertices]), len(points) - len(first)


def drop_orphans(points: Float, vertices: Int) -> tuple[Float, Int, int]:
    """Points in use, vertices renumbered to them, and how many points went."""
    used = np.zeros(len(points), bool)
    used[vertices] = True
    kept = int(used.sum())
    if kept == len(points):
        return points, vertices, 0
    number = np.cumsum(used) - 1
    return frozen_float(points[used]), frozen_int(number[vertices]), len(points) - kept


def _as_csr(cells: Any) -> tuple[Int, Int]:
    """Offsets and vertices of loops given as a list, an (n, k) array or such a pair."""
    try:
        if isinstance(cells, tuple) and len(cells) == 2 and all(np.ndim(part) == 1 for part in cells):
            first = np.asarray(cells[0])
            if isinstance(cells[0], np.ndarray) or isinstance(cells[1], np.ndarray):
                _whole_numbers(first)
                _whole_numbers(np.asarray(cells[1]))
                return frozen_int(first), frozen_int(cells[1])
        if isinstance(cells, np.ndarray) and cells.ndim == 2:
            _whole_numbers(cells)
            n, k = cells.shape
            return frozen_int(np.arange(0, n * k + 1, k) if k else np.zeros(n + 1)), frozen_int(cells.ravel())
        loops = [np.asarray(loop) for loop in cells]
        sizes = [len(loop) for loop in loops]
        flat = np.array(list(chain.from_iterable(loops)))
        _whole_numbers(flat)
    except TypeError as error:
        raise MeshError(f"cells must be vertex loops of integers: {error}") from None
    return frozen_int(np.concatenate(([0], np.cumsum(sizes, dtype=np.int64)))), frozen_int(flat)


def _whole_numbers(array: np.ndarray[Any, Any]) -> None:
    if array.size and array.dtype.kind not in "iu":
        raise MeshError(f"cells must hold integers (point numbers), not {array.dtype}")


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
    if len(offsets) < 2:
        raise MeshError("the mesh is empty: it has no cells")
    if offsets[0] != 0 or offsets[-1] != len(vertices) or (np.diff(offsets) < 0).any():
        raise MeshError("cell offsets must rise from 0 to the number of vertices given")
    check_indices(offsets, vertices, len(points), "cell")
    repairs: dict[str, int] = {}
    if merge_points:
        vertices, repairs["equal points merged"] = merge_equal(points, vertices)
    points, vertices, repairs["orphan points dropped"] = drop_orphans(points, vertices)
    points = _plane(points)
    origin = 0.5 * (points.min(axis=0) + points.max(axis=0))
    local = frozen_float(points - origin)
    vertices, repairs["clockwise cells reversed"] = _orient(local, offsets, vertices, weak)
    face_vertices, face_cells, overlaps = _faces(offsets, vertices, len(points), strict)
    repairs["overlapping edges left apart"] = overlaps
    repairs = {text: count for text, count in repairs.items() if count}
    for text, count in repairs.items():
        _log.info("%s: %d", text, count)
    mesh = Mesh(
        points=points,
        face_offsets=frozen_int(np.arange(0, 2 * len(face_cells) + 1, 2)),
        face_vertices=face_vertices.ravel(),
        face_cells=face_cells,
        cell_tags={key: frozen_int(values) for key, values in cell_tags.items()},
        repairs=repairs,
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


def _faces(offsets: Int, vertices: Int, n_points: int, strict: bool) -> tuple[Int, Int, int]:
    """Face vertices, face cells, and how many pairs of cells overlap at an edge."""
    from agglo_core.kernels.faces import match_half_edges

    face_vertices, face_cells, double, (face, cell) = match_half_edges(offsets, vertices, n_points)
    if face >= 0:
        a, b = face_vertices[face]
        cells = [c for c in (*face_cells[face].tolist(), cell) if c >= 0]
        raise MeshError(f"the face between points {a} and {b} has more than two cells, among them {cells}")
    for first, second in double.tolist():
        if first == second:
            raise MeshError(f"cell {first}: a repeated vertex (it walks an edge twice)")
        if _same(offsets, vertices, first, second):
            raise MeshError(f"cells {first} and {second} are duplicates: they have the same vertices")
        if strict:
            raise MeshError(f"cells {first} and {second} overlap: both lie on the same side of an edge")
    return frozen_int(face_vertices), frozen_int(face_cells), len(double)


def _same(offsets: Int, vertices: Int, a: int, b: int) -> bool:
    loops = (np.sort(vertices[offsets[c] : offsets[c + 1]]) for c in (a, b))
    return np.array_equal(*loops)


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
        where = shapely.get_coordinates(wrong[cells[0]])[0] + mesh.origin
        raise MeshError(
            f"{name_cells(cells)} overlap a neighbour or touch it at an unlisted vertex, "
            f"first near {where.tolist()}"
        )


def _closed(offsets: Int, vertices: Int) -> Int:
    """Vertices of each loop with the first repeated at the end."""
    return frozen_int(np.insert(vertices, offsets[1:], vertices[offsets[:-1]]))
