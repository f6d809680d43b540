"""Small test meshes, rebuilt in each call so that no component can corrupt them."""

from __future__ import annotations

from itertools import product

import numpy as np

from agglo_core.mesh import Mesh


def grid(nx: int, ny: int, *, jitter: float = 0.0, grading: float = 1.0, seed: int = 0) -> Mesh:
    """Return a mesh of ``nx`` by ``ny`` quadrilaterals.

    ``grading`` is the ratio of the last extent to the first along each axis. ``jitter`` bounds the vertex
    displacement, relative to the smallest extent beside the vertex.
    """
    axes, gaps = [], []
    for count in (nx, ny):
        extents = grading ** (np.arange(count) / max(count - 1, 1))
        axes.append(np.concatenate(([0.0], np.cumsum(extents))))
        gaps.append(np.minimum(np.append(extents, np.inf), np.insert(extents, 0, np.inf)))
    points, widths = (np.stack([x.ravel() for x in np.meshgrid(*each)], axis=1) for each in (axes, gaps))
    points += jitter * widths * np.random.default_rng(seed).uniform(-1, 1, points.shape)
    corner = (np.arange(ny)[:, None] * (nx + 1) + np.arange(nx)).ravel()
    cells = corner[:, None] + np.array([0, 1, nx + 2, nx + 1])
    return Mesh.from_polygons(points, cells, name=f"{nx} by {ny} grid")


def halved_squares(nx: int, ny: int) -> Mesh:
    """Return a mesh of ``nx`` by ``ny`` squares, each cut into two triangles."""
    quads = grid(nx, ny)
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


def hub(n: int) -> Mesh:
    """Return a mesh of a polygon with ``n`` sides, and a ring of ``n`` cells around it."""
    around = ring(n)
    loops = around.boundary_loops
    return Mesh.from_polygons(
        around.points, [*np.split(loops.vertices, loops.loop_offsets[1:-1]), np.arange(n)]
    )


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


def boxes(nx: int = 5, ny: int = 3, nz: int = 2) -> Mesh:
    """Return a 3-D mesh of unequal boxes."""
    rng = np.random.default_rng(nx + 10 * ny + 100 * nz)
    axes = [np.concatenate(([0.0], np.cumsum(rng.uniform(0.7, 1.3, n)))) for n in (nx, ny, nz)]
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
    return Mesh.from_polyhedra(points, [(a + low).tolist() for a in corner], name="boxes")
