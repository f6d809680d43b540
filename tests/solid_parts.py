"""3-D parts for tests of metrics: samples, labels, and surfaces as lists of polygons."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from agglo_core import samples
from agglo_core.mesh import Mesh

__all__ = ["MESHES", "area_vector", "outer_faces", "planes", "prism", "ragged", "turned"]


def turned(mesh: Mesh, seed: int = 4) -> Mesh:
    """Return the mesh rotated, scaled by 0.01 and shifted."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return Mesh(0.01 * mesh.points @ turn + 3.0, mesh.face_offsets, mesh.face_vertices, mesh.face_cells)


def ragged(mesh: Mesh, k: int, seed: int, swaps: float) -> np.ndarray:
    """Return labels of about k agglomerates.

    ``swaps`` adds cavities, islands and pinched edges.
    """
    rng = np.random.default_rng(seed)
    places = mesh.cell_centroids - mesh.points.min(axis=0)
    labels = cKDTree(rng.random((k, 3))).query(places / np.ptp(mesh.points, axis=0))[1]
    labels = np.where(rng.random(mesh.n_cells) < swaps, rng.integers(0, k, mesh.n_cells), labels)
    return np.unique(labels, return_inverse=True)[1]


def prism(n: int, height: float) -> Mesh:
    """Return a single prism over a regular n-gon with radius 1."""
    angle = 2 * np.pi * np.arange(n) / n
    base = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    points = np.concatenate([np.column_stack((base, np.full(n, z))) for z in (0.0, height)])
    sides = [[i, (i + 1) % n, n + (i + 1) % n, n + i] for i in range(n)]
    return Mesh.from_polyhedra(points, [[list(range(n))[::-1], list(range(n, 2 * n)), *sides]])


def outer_faces(mesh: Mesh, labels: np.ndarray, part: int) -> list[np.ndarray]:
    """Return the vertices of each face around a part, counter-clockwise from outside."""
    inside = np.append(labels == part, False)[mesh.face_cells]
    return [
        mesh.points[mesh.face_vertices[mesh.face_offsets[f] : mesh.face_offsets[f + 1]]][
            :: 1 if inside[f, 0] else -1
        ]
        for f in np.flatnonzero(inside[:, 0] != inside[:, 1])
    ]


def area_vector(corners: np.ndarray) -> np.ndarray:
    """Return the area vector of a face."""
    arms = corners[1:] - corners[0]
    return np.cross(arms[:-1], arms[1:]).sum(axis=0) / 2


def planes(faces: list[np.ndarray]) -> np.ndarray:
    """Return outward unit normals and offsets ``(n, 4)``.

    Normal · x + offset is negative inside.
    """
    found = []
    for corners in faces:
        normal = area_vector(corners) / np.linalg.norm(area_vector(corners))
        found.append([*normal, -normal @ corners[0]])
    return np.array(found)


MESHES = {
    "tetrahedra": lambda: samples.random_tetrahedra(300, seed=1),
    "voronoi": lambda: samples.voronoi3d(300, seed=2),
    "boxes": lambda: turned(samples.boxes(7)),
    "regular": lambda: samples.tetrahedra(4),
}
