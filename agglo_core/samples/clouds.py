"""Random 2-D samples: Delaunay triangles and Voronoi cells for points in the unit square."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float
from agglo_core.mesh import Mesh
from agglo_core.samples.regular import check_size

_SNAP = 1e-10
"""Points this close (in units of the square) are merged. Rounding errors are about 1e-13."""


def random_triangles(n: int, seed: int = 0) -> Mesh:
    """Delaunay triangles of ``n`` uniform random points and round(√(n/2)) evenly spaced points per side.

    Parameters
    ----------
    n : int
        Random points in the unit square: about 2n cells.
    seed : int
        Random seed, 0 or more; equal seeds give equal meshes.

    Examples
    --------
    >>> agglo.samples.random_triangles(100)
    Mesh('random triangles n=100 seed=0', 2-D, 226 cells, 353 faces, 128 points)
    """
    n = check_size(n, 1, "n", "random_triangles", memory=800)
    rng = np.random.default_rng(check_size(seed, 0, "seed", "random_triangles", 0))
    return delaunay_mesh(rng.random((n, 2)), f"random triangles n={n} seed={seed}")


def voronoi(n: int, seed: int = 0) -> Mesh:
    """Voronoi cells of ``n`` uniformly distributed points, clipped to the unit square.

    Cell i belongs to point i.

    Parameters
    ----------
    n : int
        Random points in the unit square: n cells.
    seed : int
        Random seed, 0 or more; equal seeds give equal meshes.

    Examples
    --------
    >>> agglo.samples.voronoi(100)
    Mesh('voronoi n=100 seed=0', 2-D, 100 cells, 301 faces, 202 points)
    """
    n = check_size(n, 1, "n", "voronoi", memory=1700)
    rng = np.random.default_rng(check_size(seed, 0, "seed", "voronoi", 0))
    return voronoi_mesh(rng.random((n, 2)), f"voronoi n={n} seed={seed}")


def delaunay_mesh(interior: Float, name: str) -> Mesh:
    """Return a Delaunay triangulation of the unit square with the interior points ``(n, 2)``.

    Each side has about √(n/2) segments.
    """
    from scipy.spatial import Delaunay

    # 1. Points on the sides.
    per_side = max(1, round(np.sqrt(len(interior) / 2)))
    t = np.arange(per_side) / per_side
    zero = np.zeros(per_side)
    sides = [(t, zero), (zero + 1, t), (1 - t, zero + 1), (zero, 1 - t)]
    points = np.concatenate([interior, *(np.stack(side, axis=1) for side in sides)])
    # 2. Triangulate, and drop degenerate triangles.
    cells = Delaunay(points).simplices
    corner, u, v = (points[cells[:, k]] for k in range(3))
    area = np.abs(np.linalg.det(np.stack((u - corner, v - corner), axis=1)))
    return Mesh.from_polygons(points, cells[area > _SNAP**2].astype(np.int64), name=name)


def voronoi_mesh(seeds: Float, name: str) -> Mesh:
    """Return the Voronoi mesh of the seeds ``(n, 2)`` in the unit square.

    Mirror images of the seeds clip the cells exactly. Images of seeds near a side suffice if the cells then
    stay inside, because inside the square an image is never nearer than its seed.
    """
    # 1. Cell corners, with mirror images near the sides, or of all seeds if these do not suffice.
    near = 5.0 / np.sqrt(len(seeds))
    corners, owners = _cell_corners(seeds, near)
    if near < 1.0 and not ((corners > -_SNAP) & (corners < 1 + _SNAP)).all():
        corners, owners = _cell_corners(seeds, 1.0)
    # 2. Snap corners to the sides, and merge close corners.
    for side in (0.0, 1.0):
        corners[np.abs(corners - side) < _SNAP] = side
    points, vertices = merge_close(corners)
    pairs = np.unique(np.stack((owners, vertices), axis=1), axis=0)
    # 3. Order the corners of each cell by angle.
    spoke = points[pairs[:, 1]] - seeds[pairs[:, 0]]
    order = np.lexsort((np.arctan2(spoke[:, 1], spoke[:, 0]), pairs[:, 0]))
    offsets = np.searchsorted(pairs[:, 0], np.arange(len(seeds) + 1))
    return Mesh.from_polygons(points, (offsets, pairs[order, 1]), name=name)


def _cell_corners(seeds: Float, near: float) -> tuple[Float, Float]:
    """Return the corners ``(c, 2)`` of all Voronoi cells, and the cell of each.

    Seeds within ``near`` of a side are mirrored there, so that the side bounds their cells.
    """
    from scipy.spatial import Voronoi

    # 1. Mirror the seeds near each side.
    images = [seeds]
    for axis in (0, 1):
        for side in (0.0, 1.0):
            image = seeds[np.abs(seeds[:, axis] - side) <= near]
            image[:, axis] = 2 * side - image[:, axis]
            images.append(image)
    # 2. List the ends of each ridge as corners of the cells on both sides.
    diagram = Voronoi(np.concatenate(images))
    ends = np.asarray(diagram.ridge_vertices)
    sites = diagram.ridge_points
    cell = np.stack((sites, sites), axis=2).reshape(-1)
    corner = np.stack((ends, ends), axis=1).reshape(-1)
    is_inner = cell < len(seeds)
    plane = np.vstack((diagram.vertices, np.full(2, np.inf)))  # −1 is a corner at infinity
    return plane[corner[is_inner]], cell[is_inner]


def merge_close(corners: Float) -> tuple[Float, Float]:
    """Merge points closer than ``_SNAP``.

    Returns the distinct points and each corner's point number.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    distinct, number = np.unique(corners, axis=0, return_inverse=True)
    close = cKDTree(distinct).query_pairs(_SNAP, output_type="ndarray")
    links = coo_array((np.ones(len(close)), close.T), shape=(len(distinct), len(distinct)))
    group = connected_components(links, directed=False)[1]
    _, first = np.unique(group, return_index=True)
    return distinct[first], group[number.reshape(-1)]
