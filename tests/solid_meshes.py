"""Polyhedral meshes for tests of 3-D PolyDG, and independent Gauss quadrature."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from agglo_core import Mesh, samples
from agglo_core.mesh.elements import polyhedra_from_elements

Array = NDArray[np.float64]


def hollow() -> Mesh:
    """Return cubes in irregular parts: a hollow part around another, and parts with a tunnel or branches."""
    fine = samples.boxes(6)
    c = fine.cell_centroids
    seeds = np.random.default_rng(0).random((9, 3))
    labels = np.argmin(((c[:, None] - seeds) ** 2).sum(axis=2), axis=1)
    labels[np.abs(c - 0.4).max(axis=1) < 0.3] = 9
    labels[np.abs(c - 0.4).max(axis=1) < 0.1] = 10
    labels[(np.abs(c[:, :2] - 0.75).max(axis=1) < 0.1)] = 11
    return fine.coarsen(np.unique(labels, return_inverse=True)[1])


MESHES = {
    "hexahedra": samples.boxes(3),
    "tetrahedra": samples.tetrahedra(2),
    "random tetrahedra": samples.random_tetrahedra(8, seed=3),
    "Voronoi": samples.voronoi3d(15, seed=1),
    "agglomerates of Voronoi cells": samples.voronoi3d(40, seed=2).coarsen(np.arange(40) % 7),
    "hollow": hollow(),
}


def wedge_layers(n: int, layers: int, height: float, seed: int, growth: float = 1.0) -> Mesh:
    """Return n³ cubes of six noisy tetrahedra, and layers of wedges below, whose heights grow."""
    cube = samples.tetrahedra(n)
    corners = cube.cell_vertices[1].reshape(-1, 4)
    inner = (cube.points > 1e-9) & (cube.points < 1.0 - 1e-9)
    points = cube.points + inner * np.random.default_rng(seed).uniform(-0.1 / n, 0.1 / n, cube.points.shape)
    negative = np.linalg.det(points[corners[:, 1:]] - points[corners[:, :1]]) < 0.0
    corners = np.where(negative[:, None], corners[:, [0, 2, 1, 3]], corners)
    # Extrude the triangles of the lower side
    triangles = cube.face_vertices.reshape(-1, 3)
    triangles = triangles[(cube.points[triangles, 2] < 1e-9).all(axis=1)]
    lower, triangles = np.unique(triangles, return_inverse=True)
    sheets = [lower, *(len(points) + np.arange(layers * len(lower)).reshape(layers, -1))]
    depths = np.cumsum(height * growth ** np.arange(layers))
    below = [points[lower] - [0.0, 0.0, depth] for depth in depths]
    wedges = [np.hstack((upper[triangles], under[triangles])) for upper, under in pairwise(sheets)]
    cells = polyhedra_from_elements({"tetra": corners, "wedge": np.concatenate(wedges)})
    return Mesh.from_polyhedra(np.concatenate((points, *below)), cells)


def gauss_tetrahedron(n: int) -> tuple[Array, Array]:
    """Return points and weights of Gauss quadrature on a cube, mapped to a tetrahedron."""
    x, w = np.polynomial.legendre.leggauss(n)
    r, s, t = (each.ravel() for each in np.meshgrid(*[(1 + x) / 2] * 3, indexing="ij"))
    weights = np.einsum("i,j,k->ijk", w, w, w).ravel() / 8 * (1 - s) * (1 - t) ** 2
    return np.stack((r * (1 - s) * (1 - t), s * (1 - t), t), axis=1), weights


def gauss_triangle(n: int) -> tuple[Array, Array]:
    x, w = np.polynomial.legendre.leggauss(n)
    s, t = (each.ravel() for each in np.meshgrid((1 + x) / 2, (1 + x) / 2, indexing="ij"))
    return np.stack((s * (1 - t), t), axis=1), np.outer(w, w).ravel() / 4 * (1 - t)


def loops(mesh: Mesh) -> list[Array]:
    """Return the corners of each face relative to the mesh origin."""
    return [mesh.local_points[each] for each in np.split(mesh.face_vertices, mesh.face_offsets[1:-1])]
