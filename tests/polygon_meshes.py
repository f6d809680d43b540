"""Meshes of the plane with cells of many shapes, by name and approximate number of cells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import agglo_core as agglo
from agglo_core import Mesh, samples


def hexagons(n: int) -> Mesh:
    """Hexagons in the unit square, without the cells that its boundary would cut."""
    i, j = (each.ravel() for each in np.indices((n, n)))
    around = np.array([(0, -2), (1, -1), (1, 1), (0, 2), (-1, 1), (-1, -1)])
    corners = (np.stack((2 * i + j % 2, 3 * j), axis=1)[:, None] + around).reshape(-1, 2)
    lattice, cells = np.unique(corners, axis=0, return_inverse=True)
    points = (lattice - lattice.min(axis=0)) / np.ptp(lattice, axis=0)
    return Mesh.from_polygons(points, cells.reshape(-1, 6))


def arrows(n: int) -> Mesh:
    """Squares cut by a broken line into a non-convex and a convex cell each."""
    i, j = (each.ravel() for each in np.indices((n, n)))
    corner = np.stack((i, j), axis=1)[:, None]
    points, cells = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0.7, 0.3)]), []
    for shape in ((0, 1, 2, 4), (0, 4, 2, 3)):
        cells.append(corner + points[list(shape)])
    flat = np.concatenate(cells).round(9)
    unique, numbers = np.unique(flat.reshape(-1, 2), axis=0, return_inverse=True)
    return Mesh.from_polygons(unique / n, numbers.reshape(-1, 4))


def agglomerates(n: int) -> Mesh:
    """Parts of about eight Voronoi cells."""
    mesh = samples.voronoi(8 * n, seed=3)
    return mesh.coarsen(agglo.agglomerate(mesh.graph, n_parts=n).levels[0])


def slivers(n: int, height: float = 1e-3) -> Mesh:
    """Rectangles, with rows whose height is a fraction of the others'."""
    m = int(n**0.5)
    x, rows = np.linspace(0.0, 1.0, m + 1), np.cumsum([0.0, *np.resize((1.0, height), m)])
    points = np.stack(np.meshgrid(x, rows / rows[-1], indexing="ij"), axis=-1).reshape(-1, 2)
    low = (np.arange(m)[:, None] * (m + 1) + np.arange(m)).ravel()
    return Mesh.from_polygons(points, low[:, None] + [0, m + 1, m + 2, 1])


def collapsing(length: float) -> Mesh:
    """Quadrilateral and pentagon with an edge of given length, from which a vertex hangs."""
    points = np.array([(0, 0), (1, 0), (2, 0), (2, 1), (1 + length, 1), (1, 1), (0, 1)], float)
    return Mesh.from_polygons(points, [[0, 1, 5, 6], [1, 2, 3, 4, 5]])


PLANE: dict[str, Callable[[int], Mesh]] = {
    "voronoi": lambda n: samples.voronoi(n, seed=1),
    "random triangles": lambda n: samples.random_triangles(n, seed=2),
    "agglomerates": agglomerates,
    "hexagons": lambda n: hexagons(int(n**0.5)),
    "non-convex": lambda n: arrows(int((n / 2) ** 0.5)),
    "slivers": slivers,
}
