"""Small test meshes, rebuilt in each call so that no component can corrupt them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from agglo_core import samples
from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

_SCALES = {"scaled by 1e-7": 1e-7, "scaled by 1e7": 1e7}
CHANGES = ("renumbered", "rotated", "shifted", *_SCALES)
"""Changes in numbering, position and size."""

_BIG, _SMALL = 50, 12  # rows for the large block, and for the small blocks (a multiple of 4)


def grid(nx: int, ny: int, *, width: float = 1.0, height: float = 1.0, jitter: float = 0.0) -> Mesh:
    """Return a mesh of ``nx`` by ``ny`` quadrilaterals.

    ``jitter`` bounds the vertex displacement, relative to the spacing.
    """
    x, y = np.meshgrid(np.arange(nx + 1.0), np.arange(ny + 1.0))
    points = np.stack((x.ravel(), y.ravel()), axis=1)
    if jitter:
        points += np.random.default_rng(nx * 1000 + ny).uniform(-jitter, jitter, points.shape)
    corner = (np.arange(ny)[:, None] * (nx + 1) + np.arange(nx)).ravel()
    cells = corner[:, None] + np.array([0, 1, nx + 2, nx + 1])
    return Mesh.from_polygons(points * (width, height), cells, name=f"{nx} by {ny} grid")


def halved_squares() -> Mesh:
    """Return a mesh of five by four squares, each cut into two triangles."""
    quads = grid(5, 4, jitter=0.1)
    a, b, c, d = quads.boundary_loops.vertices.reshape(-1, 4).T
    cells = np.concatenate((np.stack((a, b, c), axis=1), np.stack((a, c, d), axis=1)))
    return Mesh.from_polygons(quads.points, cells, name="halved squares")


def hexagons(nx: int, ny: int) -> Mesh:
    """Return a mesh of regular hexagons of side 1, in ``ny`` rows of ``nx``."""
    around = np.array([(0, -2), (1, -1), (1, 1), (0, 2), (-1, 1), (-1, -1)])
    centres = np.array([(2 * i + j % 2, 3 * j) for j in range(ny) for i in range(nx)])
    corners = (centres[:, None] + around).reshape(-1, 2)
    lattice, cells = np.unique(corners, axis=0, return_inverse=True)
    return Mesh.from_polygons(lattice * (np.sqrt(3) / 2, 0.5), cells.reshape(-1, 6), name="hexagons")


def ring(n: int) -> Mesh:
    """Return a mesh of an annulus: ``n`` cells that form a closed chain."""
    angle = 2 * np.pi * np.arange(n) / n
    circle = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    cells = np.stack((i, i + n, j + n, j), axis=1)
    return Mesh.from_polygons(np.concatenate((circle, 2 * circle)), cells, name="ring")


def mixed_polygons() -> Mesh:
    """Return a mesh of squares, triangles and pentagons, with hanging nodes between coarse and fine half."""
    x, y = np.meshgrid(np.arange(9.0), np.arange(7.0))
    points = np.stack((x.ravel(), y.ravel()), axis=1)
    cells: list[list[int]] = []
    for i, j in product((0, 2), (0, 2, 4)):
        a = 9 * j + i
        hanging = [a + 11] if i == 2 else []  # corner of the fine neighbours on the common edge
        cells.append([a, a + 2, *hanging, a + 20, a + 18])
    for i, j in product(range(4, 8), range(6)):
        a = 9 * j + i
        split = (i + j) % 3 == 0
        cells += [[a, a + 1, a + 10], [a, a + 10, a + 9]] if split else [[a, a + 1, a + 10, a + 9]]
    return Mesh.from_polygons(points, cells, name="mixed polygons with hanging nodes")


def comb() -> Mesh:
    """Return a mesh shaped like a comb with three tall teeth, which straight cuts disconnect."""
    i, j = np.meshgrid(np.arange(5), np.arange(9))
    inside = ((i % 2 == 0) | (j == 0)).ravel()
    full_grid = grid(5, 9)
    return Mesh.from_polygons(
        full_grid.points, full_grid.boundary_loops.vertices.reshape(-1, 4)[inside], name="comb"
    )


def two_grids() -> Mesh:
    """Return a mesh of two grids that do not touch."""
    mesh = grid(3, 2)
    loops = mesh.boundary_loops.vertices.reshape(-1, 4)
    points = np.concatenate((mesh.points, mesh.points + np.array([5.0, 1.0])))
    return Mesh.from_polygons(points, np.concatenate((loops, loops + mesh.n_points)), name="two components")


def boxes(nx: int = 5, ny: int = 3, nz: int = 2, *, cuts: int = 1, without: Sequence[int] = ()) -> Mesh:
    """Return a 3-D mesh of unequal boxes, each cut into ``cuts`` cells along each axis.

    Cells with an index in ``without`` are omitted.
    """
    # Random spacings along the axes, refined by linear interpolation.
    rng = np.random.default_rng(nx + 10 * ny + 100 * nz)
    axes = [np.concatenate(([0.0], np.cumsum(rng.uniform(0.7, 1.3, n)))) for n in (nx, ny, nz)]
    if cuts > 1:
        axes = [np.interp(np.arange((len(x) - 1) * cuts + 1) / cuts, np.arange(len(x)), x) for x in axes]
        nx, ny, nz = cuts * nx, cuts * ny, cuts * nz
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    # Index offsets of a box: its low corner, and its six faces relative to this corner.
    di, dj = (ny + 1) * (nz + 1), nz + 1
    corner = [i * di + j * dj + k for i, j, k in product(range(nx), range(ny), range(nz))]
    low = np.array(
        [
            (0, 1, dj + 1, dj),
            (0, di, di + 1, 1),
            (0, dj, di + dj, di),
            (di, di + dj, di + dj + 1, di + 1),
            (dj, dj + 1, di + dj + 1, di + dj),
            (1, di + 1, di + dj + 1, dj + 1),
        ]
    )
    polyhedra = [(a + low).tolist() for place, a in enumerate(corner) if place not in without]
    return Mesh.from_polyhedra(points, polyhedra, name="boxes")


def solids() -> list[Mesh]:
    """Return 3-D meshes without symmetries: boxes, and tetrahedra with slightly displaced points."""
    kuhn = samples.tetrahedra(3)
    shifts = np.random.default_rng(6).uniform(-0.05, 0.05, kuhn.points.shape)
    return [boxes(7, 4, 3), replace(kuhn, points=kuhn.points + shifts, name="162 tetrahedra")]


def tetrahedra() -> Mesh:
    """Return a mesh of two tetrahedra with a common face."""
    points = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.2, 0.3, 1.0), (0.3, 0.2, -1.0)]
    upper = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
    lower = [(0, 1, 2), (1, 0, 4), (2, 1, 4), (0, 2, 4)]
    return Mesh.from_polyhedra(points, [upper, lower], name="tetrahedra")


def plane_meshes() -> list[Mesh]:
    """Return connected 2-D meshes with at least two cells."""
    return [
        replace(grid(2, 1), name="two cells"),
        replace(grid(9, 1), name="strip"),
        replace(grid(12, 2, height=0.05), name="flat grid"),
        replace(grid(6, 6), name="square grid"),
        replace(grid(5, 5), name="square grid of 25 cells"),
        hexagons(5, 4),
        ring(24),
        replace(grid(9, 7, jitter=0.25), name="jittered grid"),
        mixed_polygons(),
        comb(),
    ]


def line(n: int, *, interface: float = 1.0) -> Graph:
    """Return the graph of a chain of ``n`` nodes at unit distances, with constant interface measure."""
    return _chain(np.stack((np.arange(n), np.zeros(n)), axis=1), interface)


def coincident(n: int) -> Graph:
    """Return the graph of a chain of ``n`` nodes with coincident centroids."""
    return _chain(np.zeros((n, 2)), 1.0)


def level() -> Graph:
    """Return a graph with a block of 4,000 cells and 60 blocks of 16 cells, as in a recursion."""
    mesh = grid(80, _BIG + _SMALL, jitter=0.2)
    row, column = np.divmod(np.arange(mesh.n_cells), 80)
    small = 1 + (row - _BIG) // 4 * 20 + column // 4
    graph: Graph = mesh.graph.split(np.where(row < _BIG, 0, small))[0]
    return graph


def change_mesh(mesh: Mesh, change: str) -> tuple[Mesh, Int]:
    """Renumber, rotate, shift or scale a mesh, as named in :data:`CHANGES`.

    Return the mesh and the old index per cell.
    """
    loops = mesh.boundary_loops
    cells: Sequence[Int] = np.split(loops.vertices, loops.loop_offsets[1:-1])
    rng = np.random.default_rng(5)
    order = rng.permutation(mesh.n_cells) if change == "renumbered" else np.arange(mesh.n_cells)
    points = _move_points(mesh.points, change)
    moved = Mesh.from_polygons(points, [cells[i] for i in order], name=f"{mesh.name}, {change}")
    return moved, frozen_int(order)


def _move_points(points: Float, change: str) -> Float:
    diameter = float(np.linalg.norm(np.ptp(points, axis=0)))
    cos, sin = np.cos(0.7), np.sin(0.7)
    if change == "rotated":
        return np.asarray(points @ np.array([[cos, sin], [-sin, cos]]))
    if change == "shifted":
        return points + 1e6 * diameter * np.array([cos, sin])
    return points * _SCALES.get(change, 1.0)


def _chain(centroids: Float, interface: float) -> Graph:
    n = len(centroids)
    degrees = np.full(n, 2 if n > 1 else 0)
    degrees[[0, -1]] = min(1, n - 1)
    neighbours = [j for i in range(n) for j in (i - 1, i + 1) if 0 <= j < n]
    indptr = np.concatenate(([0], np.cumsum(degrees)))
    widths = np.full(len(neighbours), interface)
    return Graph.from_arrays(indptr, np.array(neighbours, np.int32), centroids, interface=widths)
