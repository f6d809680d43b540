"""Regular 2-D samples: squares, triangles, hexagons, and shapes that are hard to agglomerate."""

from __future__ import annotations

import os

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh

_SHARE = 0.75
"""Share of the machine's memory that the construction of a sample may take: work on the mesh needs more."""


def check_size(
    value: object, least: int, option: str, sample: str, power: int = 1, memory: float = 200.0
) -> int:
    """Return ``value`` as an int if it is an integer of at least ``least``, otherwise raise OptionError.

    The error names the option and the sample. ``value ** power`` is approximately the cell count, which
    must be less than 2³¹. A ``power`` of 0 means that the value is not a size. The construction needs about
    ``memory`` bytes per ``value ** power``, and must fit into the machine. The default holds for squares.
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise OptionError(f"{option} of sample {sample} must be a whole number >= {least}, not {value!r}")
    most = int((2**31 - 1) ** (1 / power)) if power else value
    if value > most:
        raise OptionError(f"{option} of sample {sample} must be at most {most}, not {int(value)!r:.60}")
    size, total = memory * int(value) ** power, _machine_memory()
    if power and size > _SHARE * total:
        raise OptionError(
            f"{option} of sample {sample} is too large: {value} needs about {size / 1e9:.3g} GB of memory, "
            f"and this machine has {total / 1e9:.3g} GB, of which {_SHARE:.0%} can be used"
        )
    return int(value)


def _machine_memory() -> float:
    """Return the bytes of physical memory, or infinity where the system has no such number."""
    names = {"SC_PAGE_SIZE", "SC_PHYS_PAGES"}
    known = names <= getattr(os, "sysconf_names", {}).keys()
    return float(np.prod([os.sysconf(name) for name in names])) if known else np.inf


def _lattice(nx: int, ny: int) -> tuple[Float, Int]:
    """Return the integer points of an nx × ny grid and the corners ``(nx·ny, 4)`` of its squares.

    Squares are counter-clockwise, row by row.
    """
    y, x = np.divmod(np.arange((nx + 1) * (ny + 1)), nx + 1)
    j, i = np.divmod(np.arange(nx * ny), nx)
    corner = j * (nx + 1) + i
    cells = np.stack((corner, corner + 1, corner + nx + 2, corner + nx + 1), axis=1)
    return np.stack((x, y), axis=1).astype(float), cells


def squares(n: int) -> Mesh:
    """Unit square cut into ``n`` × ``n`` squares.

    Parameters
    ----------
    n : int
        Squares along each side: n² cells.

    Examples
    --------
    >>> agglo.samples.squares(4)
    Mesh('squares 4x4', 2-D, 16 cells, 40 faces, 25 points)
    """
    n = check_size(n, 1, "n", "squares", 2)
    points, cells = _lattice(n, n)
    return Mesh.from_polygons(points / n, cells, name=f"squares {n}x{n}")


def triangles(n: int) -> Mesh:
    """Unit square cut into ``n`` × ``n`` squares, each split along the diagonal (1, −1).

    Parameters
    ----------
    n : int
        Squares along each side: 2n² cells.

    Examples
    --------
    >>> agglo.samples.triangles(4)
    Mesh('triangles 4x4x2', 2-D, 32 cells, 56 faces, 25 points)
    """
    n = check_size(n, 1, "n", "triangles", 2)
    points, cells = _lattice(n, n)
    halves = cells[:, [0, 1, 3, 1, 2, 3]].reshape(-1, 3)
    return Mesh.from_polygons(points / n, halves, name=f"triangles {n}x{n}x2")


def strip(n: int) -> Mesh:
    """Row of ``n`` squares with total length 1.

    Parameters
    ----------
    n : int
        Number of squares: n cells.

    Examples
    --------
    >>> agglo.samples.strip(5)
    Mesh('strip of 5', 2-D, 5 cells, 16 faces, 12 points)
    """
    n = check_size(n, 1, "n", "strip")
    points, cells = _lattice(n, 1)
    return Mesh.from_polygons(points / n, cells, name=f"strip of {n}")


def disconnected(n: int) -> Mesh:
    """Two unit squares half a unit apart, each cut into ``n`` × ``n`` squares.

    Parameters
    ----------
    n : int
        Squares along each side: 2n² cells.

    Examples
    --------
    >>> agglo.samples.disconnected(2)
    Mesh('two 2x2 squares', 2-D, 8 cells, 24 faces, 18 points)
    """
    n = check_size(n, 1, "n", "disconnected", 2)
    points, cells = _lattice(n, n)
    both = np.concatenate((points / n, points / n + [1.5, 0.0]))
    return Mesh.from_polygons(both, np.concatenate((cells, cells + len(points))), name=f"two {n}x{n} squares")


def hexagons(n: int) -> Mesh:
    """Grid of ``n`` rows with ``n`` regular hexagons each, odd rows shifted by half a cell.

    The total width is 1 for n > 1. Corners are numbered on a lattice of half widths and half radii, so that
    neighbours share them.

    Parameters
    ----------
    n : int
        Hexagons per row, and rows: n² cells.

    Examples
    --------
    >>> agglo.samples.hexagons(3)
    Mesh('hexagons 3x3', 2-D, 9 cells, 38 faces, 30 points)
    """
    n = check_size(n, 1, "n", "hexagons", 2)
    j, i = np.divmod(np.arange(n * n), n)
    centres = np.stack((2 * i + 1 + j % 2, 3 * j + 2), axis=1)
    corners = np.array([(1, -1), (1, 1), (0, 2), (-1, 1), (-1, -1), (0, -2)])
    lattice, cells = np.unique((centres[:, None] + corners).reshape(-1, 2), axis=0, return_inverse=True)
    unit = 1.0 / (2 * n + 1)
    points = lattice * [unit, unit / np.sqrt(3.0)]
    return Mesh.from_polygons(points, cells.reshape(-1, 6), name=f"hexagons {n}x{n}")


def ring(n: int) -> Mesh:
    """Annulus with radii 1/2 and 1: several layers of ``n`` nearly square quadrilaterals each.

    Parameters
    ----------
    n : int
        Quadrilaterals around the annulus, 3 or more: about n²/9 cells.

    Examples
    --------
    >>> agglo.samples.ring(12)
    Mesh('ring 12x1', 2-D, 12 cells, 36 faces, 24 points)
    """
    n = check_size(n, 3, "n", "ring")
    layers = max(1, round(n / (3 * np.pi)))
    lattice, cells = _lattice(n, layers)  # x runs around the annulus, y inward
    is_distinct = lattice[:, 0] < n
    radius, angle = 1.0 - 0.5 * lattice[is_distinct, 1] / layers, 2 * np.pi * lattice[is_distinct, 0] / n
    points = radius[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    last = cells % (n + 1) == n  # identify the last lattice column with the first
    number = np.cumsum(is_distinct) - 1
    return Mesh.from_polygons(points, number[np.where(last, cells - n, cells)], name=f"ring {n}x{layers}")
