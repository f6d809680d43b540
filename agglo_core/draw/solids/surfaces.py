"""Outer faces of parts in 3-D, optionally moved apart, and their projection to a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.draw.solids.depth_buffer import nearest_faces
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh

SIDE: Final = (-60.0, 30.0)
"""Default azimuth and elevation of the eye in degrees, in matplotlib's convention."""
_EDGE_ON = 1e-6  # cosine between normal and eye


@dataclass(frozen=True)
class Surface:
    """Outer faces of parts in 3-D: corners, adjacent cell and part, and normals.

    Attributes
    ----------
    corners : (c, 3) float
        Face f has the corners ``corners[offsets[f]:offsets[f + 1]]``, relative to the mesh centre.
    offsets : (f + 1,) int
    cells, parts : (f,) int
        Inner cell per face, and its part.
    normals : (f, 3) float
        Outward unit normals.
    """

    corners: Float
    offsets: Int
    cells: Int
    parts: Int
    normals: Float


@dataclass(frozen=True)
class Sight:
    """Projection of a surface to pixels: visible face and depth at each pixel.

    Attributes
    ----------
    faces : (height, width) int
        Face of the surface, −1 for none. Row 0 is at the top.
    depth : (height, width) float
        Depth towards the eye, in pixels.
    eye : (3,) float
        Unit vector towards the eye.
    """

    faces: Int
    depth: Float
    eye: Float


def check_explode(explode: object) -> float:
    """Check the factor by which parts are moved apart: a number from 0 to 10."""
    if (
        isinstance(explode, bool)
        or not isinstance(explode, int | float | np.number)
        or not 0 <= explode <= 10
    ):
        raise OptionError(
            f"explode must be a number from 0 (parts stay in place) to 10, given {explode!r:.60}"
        )
    return float(explode)


def outer_faces(mesh: Mesh, labels: Int, explode: float = 0.0, kept: Mask | None = None) -> Surface:
    """Return the boundary faces, and the faces between different parts once for each part.

    Parameters
    ----------
    mesh : Mesh
        3-D mesh.
    labels : (n_cells,) int
        Part per cell.
    explode : float
        Each part is moved by this factor times the vector from the mesh centre to its centroid.
    kept : (n_cells,) bool, optional
        Present cells (default: all). Faces towards absent cells are outer faces.
    """
    # Select the faces seen from either side.
    present = labels if kept is None else np.where(kept, labels, -1)
    sides = np.append(present, -1)[mesh.face_cells]
    owned = np.flatnonzero((sides[:, 0] >= 0) & (sides[:, 0] != sides[:, 1]))
    neighboured = np.flatnonzero((sides[:, 1] >= 0) & (sides[:, 0] != sides[:, 1]))
    faces = np.concatenate((owned, neighboured))
    inside = np.repeat([0, 1], [len(owned), len(neighboured)])
    # Collect their corners, moved apart.
    sizes = np.diff(mesh.face_offsets)[faces]
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    places = np.arange(offsets[-1]) + np.repeat(mesh.face_offsets[faces] - offsets[:-1], sizes)
    parts = sides[faces, inside]
    corners = mesh.local_points[mesh.face_vertices[places]]
    if explode:
        corners = corners + explode * np.repeat(_part_centres(mesh, labels)[parts], sizes, axis=0)
    outward = mesh.face_normals[faces] * (1.0 - 2.0 * inside)[:, None]
    return Surface(corners, offsets, mesh.face_cells[faces, inside], parts, outward)


def _part_centres(mesh: Mesh, labels: Int) -> Float:
    """Return the centroid of each part relative to that of the mesh ``(k, 3)``."""
    volume = np.bincount(labels, mesh.cell_measures)
    moments = [np.bincount(labels, mesh.cell_measures * x) for x in mesh.local_centroids.T]
    centres: Float = np.stack(moments, axis=1) / volume[:, None]
    return centres - np.average(centres, axis=0, weights=volume)


def mark_cells_beyond(mesh: Mesh, normal: Sequence[float]) -> Mask:
    """Mark the cells whose centroid is beyond a plane with this normal through the mesh centre.

    Raises OptionError if the normal is not a direction, or no cell is left.
    """
    direction = np.array(normal, dtype=float)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise OptionError(f"section must be a direction, three numbers not all 0, given {normal!r:.60}")
    is_beyond: Mask = mesh.local_centroids @ direction > 0.0
    if is_beyond.all():
        raise OptionError(f"section {normal!r:.60}: no cell is left on this side of the centre")
    return is_beyond


def axes_of(azimuth: float, elevation: float) -> Float:
    """Return the unit vectors to the right, up and towards the viewer ``(3, 3)``, for angles in degrees."""
    a, e = np.radians([azimuth, elevation])
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    return np.stack((right, np.cross(eye, right), eye))


def project_surface(surface: Surface, side: tuple[float, float] = SIDE, pixels: int = 800) -> Sight:
    """Project a surface orthogonally to a picture with a longer side of ``pixels`` pixels.

    Faces seen from inside or edge-on are hidden.
    """
    axes = axes_of(*side)
    placed = surface.corners @ axes.T
    low, high = placed.min(axis=0), placed.max(axis=0)
    scale = (pixels - 4) / max(*(high - low)[:2], np.finfo(float).tiny)
    placed = (placed - [low[0], high[1], 0.0]) * [scale, -scale, scale] + [2.0, 2.0, 0.0]  # rows go down
    width, height = (int(np.ceil(each)) + 4 for each in scale * (high - low)[:2])
    normals = surface.normals @ axes.T * [1.0, -1.0, 1.0]
    facing = np.flatnonzero(normals[:, 2] > _EDGE_ON)
    faces, depth = nearest_faces(
        frozen_float(placed),
        frozen_int(surface.offsets),
        frozen_int(facing),
        frozen_float(_planes(placed, surface.offsets, normals)),
        width,
        height,
    )
    return Sight(faces, depth, axes[2])


def _planes(corners: Float, offsets: Int, normals: Float) -> Float:
    """Return the depth per face as a linear function of x and y: coefficients ``(f, 3)``.

    A face's plane passes through the mean of its corners.
    """
    middle = np.add.reduceat(corners, offsets[:-1]) / np.diff(offsets)[:, None]
    slope = -normals[:, :2] / np.where(np.abs(normals[:, 2:]) > _EDGE_ON, normals[:, 2:], 1.0)
    flat: Float = middle[:, 2] - np.einsum("ij,ij->i", slope, middle[:, :2])
    return np.column_stack((flat, slope))
