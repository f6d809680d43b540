"""Random 3-D samples: Delaunay tetrahedra and Voronoi cells for points in the unit cube."""

from __future__ import annotations

from itertools import product

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.mesh import Mesh
from agglo_core.samples.clouds import merge_close
from agglo_core.samples.regular import check_size

_SNAP = 1e-10
"""Points this close are merged. Rounding errors are about 1e-13."""
_APART = 0.7
"""Minimum distance of interior points in grid spacings. Points nearer to another point are dropped."""


def random_tetrahedra(n: int, seed: int = 0) -> Mesh:
    """Delaunay tetrahedra of evenly spread random points in the unit cube and on its surface.

    Parameters
    ----------
    n : int
        Number of random points, before points too close to another point are dropped: about 6 n tetrahedra.
    seed : int
        Random seed, 0 or more; equal seeds give equal meshes.

    Examples
    --------
    >>> agglo.samples.random_tetrahedra(50)
    Mesh('random tetrahedra n=50 seed=0', 3-D, 464 cells, 1024 faces, 131 points)
    """
    from scipy.spatial import Delaunay

    from agglo_core.mesh.elements import polyhedra_from_elements

    n = check_size(n, 1, "n", "random_tetrahedra", memory=3000)
    rng = np.random.default_rng(check_size(seed, 0, "seed", "random_tetrahedra", 0))
    # 1. Randomly displaced grid points on the surface.
    per_edge = max(1, round(n ** (1 / 3)))
    grid = np.array(list(product(range(per_edge + 1), repeat=3)))
    grid = grid[((grid == 0) | (grid == per_edge)).any(axis=1)]
    moves = rng.uniform(-0.3, 0.3, grid.shape)  # along the surface: coplanar points only there
    outside = (grid + np.where((grid == 0) | (grid == per_edge), 0.0, moves)) / per_edge
    # 2. Random points inside, at a minimum distance.
    away = 0.5 * _APART / per_edge
    inside = _drop_close_points(rng.uniform(away, 1 - away, (n, 3)), _APART / per_edge)
    points = np.concatenate([inside, outside])
    # 3. Triangulate, orient the tetrahedra, and drop flat ones.
    cells = Delaunay(points).simplices
    corner, *others = (points[cells[:, k]] for k in range(4))
    volume = np.linalg.det(np.stack([other - corner for other in others], axis=1))
    cells[volume < 0.0] = cells[volume < 0.0][:, [0, 2, 1, 3]]
    kept = cells[np.abs(volume) > _SNAP].astype(np.int64)  # the others are flat: four points on a side
    mesh = polyhedra_from_elements({"tetra": kept})
    return Mesh.from_polyhedra(points, mesh, name=f"random tetrahedra n={n} seed={seed}")


def voronoi3d(n: int, seed: int = 0) -> Mesh:
    """Voronoi cells of ``n`` uniformly distributed points, clipped to the unit cube.

    Cell i belongs to point i.

    Parameters
    ----------
    n : int
        Random points in the unit cube: n cells.
    seed : int
        Random seed, 0 or more; equal seeds give equal meshes.

    Examples
    --------
    >>> agglo.samples.voronoi3d(20)
    Mesh('voronoi solids n=20 seed=0', 3-D, 20 cells, 117 faces, 100 points)
    """
    from scipy.spatial import Voronoi

    n = check_size(n, 1, "n", "voronoi3d", memory=40_000)
    seeds = np.random.default_rng(check_size(seed, 0, "seed", "voronoi3d", 0)).random((n, 3))
    # 1. Voronoi diagram of the points and their mirror images.
    images = [seeds]  # mirror images clip the cells exactly
    for axis, side in product(range(3), (0.0, 1.0)):
        image = seeds.copy()
        image[:, axis] = 2 * side - image[:, axis]
        images.append(image)
    diagram = Voronoi(np.concatenate(images))
    points, number = merge_close(diagram.vertices)
    # 2. Each ridge is a face of the cells on both sides.
    cells: list[list[list[int]]] = [[] for _ in range(n)]
    for (first, second), vertices in zip(diagram.ridge_points, diagram.ridge_vertices, strict=True):
        if min(first, second) >= n or min(vertices) < 0:
            continue
        loop = [int(v) for v in dict.fromkeys(number[vertices])]
        if len(loop) < 3:  # an edge of the surface, where four cells meet, two of them images
            continue
        ahead = _turn(points[loop]) @ (diagram.points[second] - diagram.points[first]) > 0.0
        for cell, outward in ((first, ahead), (second, not ahead)):
            if cell < n:
                cells[cell].append(loop if outward else loop[::-1])
    # 3. Drop unused points, and snap corners to the sides.
    used_points, loops = _drop_unused_points(cells)
    corners = points[used_points]
    for side in (0.0, 1.0):
        corners[np.abs(corners - side) < _SNAP] = side
    return Mesh.from_polyhedra(corners, loops, name=f"voronoi solids n={n} seed={seed}")


def _turn(loop: Float) -> Float:
    """Return the area vector ``(3,)`` of a closed polygon by the right-hand rule."""
    spokes = loop[1:] - loop[0]
    vector: Float = np.cross(spokes[:-1], spokes[1:]).sum(axis=0)
    return vector


def _drop_unused_points(cells: list[list[list[int]]]) -> tuple[Int, list[list[list[int]]]]:
    """Remove points that no cell uses, and renumber the points of the cells."""
    used = np.unique([v for cell in cells for loop in cell for v in loop])
    place = dict(zip(used.tolist(), range(len(used)), strict=True))
    return used, [[[place[v] for v in loop] for loop in cell] for cell in cells]


def _drop_close_points(points: Float, distance: float) -> Float:
    """Remove each point closer than ``distance`` to an earlier point that is kept."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    keep = np.ones(len(points), bool)
    for earlier, later in pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))]:
        keep[later] &= not keep[earlier]
    return points[keep]
