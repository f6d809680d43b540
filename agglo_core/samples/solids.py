"""3-D samples: hexahedra, tetrahedra and prisms that fill the unit cube."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.mesh import Mesh
from agglo_core.samples.clouds import random_triangles
from agglo_core.samples.regular import check_size


def boxes(n: int) -> Mesh:
    """Unit cube cut into n³ cubes.

    Parameters
    ----------
    n : int
        Cubes along each edge: n³ cells.

    Examples
    --------
    >>> agglo.samples.boxes(2)
    Mesh('boxes 2x2x2', 3-D, 8 cells, 36 faces, 27 points)
    """
    from agglo_core.mesh.elements import polyhedra_from_elements

    n = check_size(n, 1, "n", "boxes", 3, memory=900)
    points, corners = _cubes(n)
    hexahedra = corners[:, [0, 1, 3, 2, 4, 5, 7, 6]]  # bottom loop, then top loop
    cells = polyhedra_from_elements({"hexahedron": hexahedra})
    return Mesh.from_polyhedra(points, cells, name=f"boxes {n}x{n}x{n}")


def tetrahedra(n: int) -> Mesh:
    """Unit cube cut into n³ cubes, each split into six tetrahedra around its main diagonal (Kuhn).

    Parameters
    ----------
    n : int
        Cubes along each edge: 6n³ cells.

    Examples
    --------
    >>> agglo.samples.tetrahedra(2)
    Mesh('tetrahedra 2x2x2x6', 3-D, 48 cells, 120 faces, 27 points)
    """
    from agglo_core.mesh.elements import polyhedra_from_elements

    n = check_size(n, 1, "n", "tetrahedra", 3, memory=2700)
    points, corners = _cubes(n)
    paths = []
    for x, y, z in permutations((1, 2, 4)):  # corner 0 to corner 7, one axis after the other
        even = (x, y, z) in ((1, 2, 4), (2, 4, 1), (4, 1, 2))
        paths.append([0, x, x + y, 7] if even else [0, x + y, x, 7])
    cells = polyhedra_from_elements({"tetra": corners[:, paths].reshape(-1, 4)})
    return Mesh.from_polyhedra(points, cells, name=f"tetrahedra {n}x{n}x{n}x6")


def prisms(n: int, layers: int = 0, seed: int = 0) -> Mesh:
    """Unit cube divided into layers of prisms: extruded Delaunay triangles of ``n`` random points.

    Parameters
    ----------
    n : int
        Random points of the triangulation :func:`random_triangles`: about 2n prisms per layer.
    layers : int
        Layers along z; 0 for round(√n), with prisms about as high as wide.
    seed : int
        Random seed, 0 or more; equal seeds give equal meshes.

    Examples
    --------
    >>> prisms(100).n_cells == 10 * random_triangles(100).n_cells
    True
    """
    from agglo_core.mesh.elements import polyhedra_from_elements

    plane = random_triangles(check_size(n, 1, "n", "prisms"), check_size(seed, 0, "seed", "prisms", 0))
    # 1. Number of layers, and the triangles of the plane mesh.
    layers = check_size(layers, 0, "layers", "prisms") or max(1, round(np.sqrt(n)))
    triangles = plane.boundary_loops.vertices.reshape(-1, 3)
    # 2. Extrude the triangles layer by layer.
    sheet = np.arange(layers)[:, None, None] * plane.n_points
    below, above = triangles + sheet, triangles + sheet + plane.n_points
    wedges = np.concatenate((below[..., ::-1], above[..., ::-1]), axis=2).reshape(-1, 6)
    height = np.repeat(np.linspace(0.0, 1.0, layers + 1), plane.n_points)
    points = np.column_stack((np.tile(plane.points, (layers + 1, 1)), height))
    cells = polyhedra_from_elements({"wedge": wedges})
    return Mesh.from_polyhedra(points, cells, name=f"prisms n={n} layers={layers} seed={seed}")


def _cubes(n: int) -> tuple[Float, Int]:
    """Return points and corners ``(n³, 8)`` of the n³ cubes in the unit cube.

    The bits 1, 2, 4 of a corner's position are x, y, z.
    """
    grid = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    z, y, x = np.unravel_index(grid.ravel(), grid.shape)
    place = np.arange(8)
    step = (place & 1) + (place >> 1 & 1) * (n + 1) + (place >> 2) * (n + 1) ** 2
    return np.stack((x, y, z), axis=1) / n, grid[:-1, :-1, :-1].reshape(-1, 1) + step
