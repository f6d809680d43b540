"""Rock layers with faults: materials as a cell tag, faults and sides as face tags."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_int
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import polyhedra_from_elements
from agglo_core.samples.regular import check_size

_TOPS = (0.12, 0.3, 0.38, 0.6, 0.7)  # tops of all layers except the last, as fractions of the height
_FAULTS = ((0.35, -0.35), (0.7, 0.45))  # position on the x axis, and lean over the height
_THROW = 0.12  # drop of the block between the faults, as a fraction of the height
_DIP, _FOLD = 0.25, 0.08


def layered(n: int = 24) -> Mesh:
    """Six rock layers, tilted and folded, with the middle block dropped between two faults.

    Hexahedra with plane faces on a unit square of ground, half as high. The cell tag ``material`` numbers the
    layers from 1 at the bottom to 6. The face tag ``fault`` is 1 and 2 on the two faults. The face tag
    ``side`` is 1 to 6 on the boundary: low and high x, y, z.

    Parameters
    ----------
    n : int
        Hexahedra along x and y, half as many along z: about n³/2 cells.

    Examples
    --------
    >>> mesh = layered(24)
    >>> mesh, np.bincount(mesh.face_tags["fault"]).tolist()
    (Mesh('layered 24x24x12', 3-D, 6912 cells, 21888 faces, 8125 points), [21312, 288, 288])
    """
    n = check_size(n, 4, "n", "layered", 3)
    # 1. Hexahedra of the grid, with the dropped block between the faults.
    counts = (n, n, max(2, n // 2))
    i, j, k = (each.ravel() for each in np.indices(counts))
    at = [round(place * n) for place, _ in _FAULTS]
    dropped = (i >= at[0]) & (i < at[1])
    # 2. Material by height before the drop.
    depth = (k + 0.5) / counts[2] + np.where(dropped, max(1, round(_THROW * counts[2])) / counts[2], 0.0)
    mesh = Mesh.from_polyhedra(
        _bend_grid(counts),
        polyhedra_from_elements({"hexahedron": _corners(counts, i, j, k)}),
        cell_tags={"material": 1 + np.searchsorted(_TOPS, depth)},
        name=f"layered {'x'.join(map(str, counts))}",
    )
    # 3. Tags of the sides and faults.
    ends = [_plane_numbers(mesh, counts, axis, [0, counts[axis]]) for axis in range(3)]
    side = sum(np.where(end > 0, end + 2 * axis, 0) for axis, end in enumerate(ends))
    return mesh.with_face_tags(fault=_plane_numbers(mesh, counts, 0, at), side=side)


def _bend_grid(counts: tuple[int, ...]) -> Float:
    """Return the points of a Cartesian grid bent along the rock layers, with x varying fastest.

    Lines along z lean like the faults. The lift is a function of x plus a function of y, so all faces are
    plane: parallelograms, and trapezia in the planes of constant y.
    """
    places = np.indices([n + 1 for n in reversed(counts)])
    zeta, y, xi = (each.ravel() / n for each, n in zip(places, counts[::-1], strict=True))
    known, leaning = np.array([(0.0, 0.0), *_FAULTS, (1.0, 0.0)]).T
    lean = np.interp(xi, known, leaning)
    lift = _DIP * xi + _FOLD * np.sin(2 * np.pi * y)
    return np.stack((xi + 0.5 * lean * (zeta - 0.5), y, 0.5 * zeta + lift), axis=1)


def _corners(counts: tuple[int, ...], i: Int, j: Int, k: Int) -> Int:
    """Return the corners ``(n, 8)`` of the hexahedra with grid indices (i, j, k), in VTK order."""
    row, sheet = counts[0] + 1, (counts[0] + 1) * (counts[1] + 1)
    step = np.array([0, 1, row + 1, row])
    corners: Int = (i + j * row + k * sheet)[:, None] + np.concatenate((step, step + sheet))
    return corners


def _plane_numbers(mesh: Mesh, counts: tuple[int, ...], axis: int, places: list[int]) -> Int:
    """Return 1 for faces on the first of the given grid planes, 2 on the second, 0 elsewhere."""
    place: Int = np.unravel_index(mesh.face_vertices.reshape(-1, 4), [n + 1 for n in reversed(counts)])[
        2 - axis
    ]
    on: Mask = np.stack([(place == each).all(axis=1) for each in places])
    return frozen_int(np.where(on.any(axis=0), 1 + on.argmax(axis=0), 0))
