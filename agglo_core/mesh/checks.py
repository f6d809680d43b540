"""Check and repair arrays before a mesh is built."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, exact_cast, frozen_float, frozen_int, owned, plain_array, splitmix
from agglo_core.errors import MeshError

_log = logging.getLogger("agglo")

_SMALLEST, _LARGEST = 1e-50, 1e50  # extents of meshes: fifth powers (moments of volume) keep all digits


def box_centre(points: Float) -> Float:
    """Return the bounding-box centre ``(d,)`` of ``points (n, d)``.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.mesh import box_centre
    >>> box_centre(np.array([[0.0, 0.0], [4.0, 1.0], [1.0, 2.0]]))
    array([2., 1.])
    """
    # column by column: numpy reduces the long axis of a narrow array ten times slower
    return frozen_float([0.5 * (column.min() + column.max()) for column in points.T])


def last_place(points: Float) -> float:
    """Return the unit in the last place of the largest coordinate.

    If all coordinates are float32 numbers, it is the unit in single precision.
    """
    largest = np.abs(points).max()
    with np.errstate(over="ignore", under="ignore"):
        single = (points == points.astype(np.float32)).all()
    return float(np.spacing(np.float32(largest)) if single else np.spacing(largest))


def name_cells(cells: ArrayLike) -> str:
    """Format cell indices for messages: ``cell 3`` or ``cells 3, 8, 12, … (40 in all)``."""
    array = np.atleast_1d(cells)
    numbers = ", ".join(str(int(cell)) for cell in array[:5])
    if len(array) == 1:
        return f"cell {numbers}"
    return f"cells {numbers}" + (f", … ({len(array)} in all)" if len(array) > 5 else "")


def check_points(points: ArrayLike) -> Float:
    """Return the points as a read-only float array ``(n, 2)`` or ``(n, 3)``, or raise MeshError.

    :func:`check_finite` checks the values.
    """
    given = plain_array(points, "points")
    array = owned(frozen_float(exact_cast(given, np.float64, "points")))
    if array.ndim != 2 or array.shape[1] not in (2, 3):
        raise MeshError(f"points must have shape (n_points, 2) or (n_points, 3), not {array.shape}")
    return array


def check_finite(points: Float, vertices: Int | None = None) -> None:
    """Raise MeshError if a coordinate of the points ``vertices`` (default: all) is not finite."""
    finite = np.isfinite(points)
    if finite.all():
        return
    is_vertex = np.full(len(points), vertices is None)
    if vertices is not None:
        is_vertex[vertices] = True
    bad = np.flatnonzero(is_vertex & ~finite.all(axis=1))
    if len(bad):
        raise MeshError(f"point {bad[0]} is not finite: {points[bad[0]].tolist()} ({len(bad)} such points)")


def check_faces(points: Float, offsets: Int, vertices: Int, cells: Int) -> None:
    """Raise MeshError unless the mesh arrays have consistent shapes and index ranges."""
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise MeshError(f"points must have shape (n_points, 2) or (n_points, 3), not {points.shape}")
    check_finite(points)
    if cells.ndim != 2 or cells.shape[1] != 2:
        raise MeshError(f"face_cells must have shape (n_faces, 2), not {cells.shape}")
    if not len(cells):
        raise MeshError("the mesh is empty: it has no faces")
    # Vertex lists of the faces.
    if len(offsets) != len(cells) + 1 or offsets[0] != 0 or offsets[-1] != len(vertices):
        raise MeshError(
            f"face_offsets must be {len(cells) + 1} numbers that increase from 0 to {len(vertices)}, to "
            "match the lengths of face_cells and face_vertices"
        )
    sizes, dim = np.diff(offsets), points.shape[1]
    wrong = np.flatnonzero(sizes != 2 if dim == 2 else sizes < 3)
    if len(wrong):
        wanted = "two vertices in 2-D" if dim == 2 else "at least three vertices in 3-D"
        raise MeshError(f"face_offsets: a face must have {wanted}, but face {wrong[0]} has {sizes[wrong[0]]}")
    if vertices.view(np.uint64).max() >= len(points):  # single pass: negative numbers become large
        raise MeshError(f"face_vertices must lie in 0..{len(points) - 1}")
    # Cells at the faces.
    if cells[:, 0].min() < 0 or cells[:, 1].min() < -1:
        raise MeshError("face_cells: every face needs an owner cell, and a neighbour cell or -1")
    n_cells = int(cells.max()) + 1
    if n_cells > cells.size:
        raise MeshError(f"face_cells: {len(cells)} faces cannot bound {n_cells} cells")
    same = np.flatnonzero(cells[:, 0] == cells[:, 1])
    if len(same):
        raise MeshError(f"face_cells: face {same[0]} has cell {cells[same[0], 0]} on both sides")


def check_extent(points: Float) -> None:
    """Raise MeshError if the mesh is too small or too large for accurate moments of its cells."""
    extent = max((float(column.max()) - float(column.min()) for column in points.T), default=0.0)
    if extent > _LARGEST or 0 < extent < _SMALLEST:
        raise MeshError(
            f"the mesh is {extent:.3g} across; areas, volumes and their moments can be computed only from "
            f"{_SMALLEST:g} to {_LARGEST:g}: choose another unit of length"
        )


def check_offsets(offsets: Int, total: int, what: str) -> None:
    """Raise MeshError unless the CSR offsets increase from 0 to ``total``."""
    if len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != total or (np.diff(offsets) < 0).any():
        raise MeshError(f"{what} offsets must increase from 0 to {total}, the number of entries")


def check_indices(offsets: Int, vertices: Int, n_points: int) -> None:
    """Raise MeshError unless all vertex indices are in 0..n_points−1.

    Cell c has the vertices ``offsets[c]:offsets[c + 1]``.
    """
    if vertices.min(initial=0) < 0 or vertices.max(initial=-1) >= n_points:
        bad = np.flatnonzero((vertices < 0) | (vertices >= n_points))
        owner = int(np.searchsorted(offsets, bad[0], side="right")) - 1
        raise MeshError(f"cell {owner} uses point {vertices[bad[0]]}, but there are {n_points} points")


def compact_points(points: Float, vertices: Int, merge: bool) -> tuple[Int, Int, dict[str, int]]:
    """Drop unused points, optionally merge equal points, and renumber the vertices.

    Return the indices of the kept points, the renumbered vertices, and both repair counts.
    """
    merged = 0
    if merge:
        vertices, merged = merge_equal(points, vertices)
    is_used = np.zeros(len(points), bool)
    is_used[vertices] = True
    n_used = int(is_used.sum())
    repairs = {"equal points merged": merged, "orphan points dropped": len(points) - n_used - merged}
    number = np.cumsum(is_used) - 1
    renumbered = vertices if n_used == len(points) else frozen_int(number[vertices])
    return frozen_int(np.flatnonzero(is_used)), renumbered, repairs


def merge_equal(points: Float, vertices: Int) -> tuple[Int, int]:
    """Merge equal points: return the renumbered vertices and the number of superfluous points."""
    points = points + 0.0  # -0.0 equals 0.0
    some = _points_with_equal_hash(points)
    if not len(some):
        return vertices, 0
    # Sort the candidates and map each class of equal points to its smallest number.
    order = some[np.lexsort(points[some].T)]
    new = np.concatenate(([True], (np.diff(points[order], axis=0) != 0).any(axis=1)))
    first = np.minimum.reduceat(order, np.flatnonzero(new))
    if len(first) == len(some):
        return vertices, 0
    target = np.arange(len(points))
    target[order] = first[np.cumsum(new) - 1]
    return frozen_int(target[vertices]), len(some) - len(first)


def _points_with_equal_hash(points: Float) -> Int:
    """Return candidates for equal points: indices of points whose coordinates have equal hashes."""
    bits = np.ascontiguousarray(points).view(np.uint64)
    key = bits[:, 0]
    for column in bits.T[1:]:
        key = splitmix(key) ^ column
    key = splitmix(key)
    ranked = np.sort(key)
    double = ranked[1:][ranked[1:] == ranked[:-1]]
    return frozen_int(np.flatnonzero(np.isin(key, double)) if len(double) else [])


def note_repairs(repairs: Mapping[str, int]) -> dict[str, int]:
    """Log the repairs made to a mesh, and return those with a positive count."""
    counts = {text: count for text, count in repairs.items() if count}
    for text, count in counts.items():
        _log.info("%s: %d", text, count)
    return counts


def warn_of_overlaps(pairs: Int) -> None:
    """Log a warning for 2-D cell pairs ``(k, 2)`` that lie on the same side of a common edge."""
    if len(pairs):
        _log.warning(
            "%d pairs of cells overlap at an edge, such as cells %d and %d: their common area is counted "
            "twice. In a periodic mesh, give cells that wrap around separate points on the far side",
            len(pairs),
            *sorted(pairs[0].tolist()),
        )


def whole_numbers(values: Any, what: str, dimensions: int = 1) -> Int:
    """Return values as an integer array with the given number of dimensions, or raise MeshError."""
    array = plain_array(values, what)
    if array.size and array.dtype.kind not in "iu":
        raise MeshError(f"{what} must hold integers, not {array.dtype}")
    if array.ndim != dimensions:
        shape = "one-dimensional" if dimensions == 1 else f"of {dimensions} dimensions"
        raise MeshError(f"{what} must be {shape}, not of shape {array.shape}")
    return frozen_int(exact_cast(array, np.int64, what))


def check_labels(labels: ArrayLike, n: int) -> Int:
    """Return the part labels of cells as ``(n,)`` int64, or raise MeshError unless they cover 0..k−1.

    Examples
    --------
    >>> from agglo_core.mesh import check_labels
    >>> check_labels([1, 0, 1], 3)
    array([1, 0, 1])
    """
    array = plain_array(labels, "labels")
    if array.shape != (n,) or array.dtype.kind not in "iu":
        strange = array.dtype == object  # something other than numbers, such as a Hierarchy
        found = type(labels).__name__ if strange else f"shape {array.shape}, dtype {array.dtype}"
        raise MeshError(
            f"labels must be ({n},) integers, one per cell, as hierarchy.levels[0]; given {found}"
        )
    array = frozen_int(exact_cast(array, np.int64, "labels"))
    if array.min() < 0:
        raise MeshError(f"label of cell {int(array.argmin())} is negative")
    missing = np.flatnonzero(np.bincount(np.minimum(array, n)) == 0)  # labels above n leave gaps
    if len(missing):
        raise MeshError(f"labels have gaps: no cell has label {int(missing[0])} (of 0..{array.max()})")
    return array


def check_tags(kind: str, tags: Mapping[str, ArrayLike], count: int) -> dict[str, Int]:
    """Return checked tags as read-only int64 arrays ``(count,)`` by name, or raise MeshError."""
    if not isinstance(tags, Mapping):
        expected = f"a mapping from names to ({count},) integers, such as {{'material': [0, 1, …]}}"
        raise MeshError(f"{kind} tags must be {expected}, given {type(tags).__name__}")
    checked = {}
    for name, values in tags.items():
        array = plain_array(values, f"{kind} tag {name!r}")
        if array.shape != (count,):
            raise MeshError(f"{kind} tag {name!r} has shape {array.shape}, expected ({count},)")
        if array.dtype.kind not in "iub":
            raise MeshError(f"{kind} tag {name!r} must hold integers, not {array.dtype}")
        checked[name] = owned(frozen_int(exact_cast(array, np.int64, f"{kind} tag {name!r}")))
    return checked
