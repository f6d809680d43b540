"""Polyhedral meshes for tests of 3-D PolyDG, and independent Gauss quadrature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agglo_core import Mesh, samples

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
