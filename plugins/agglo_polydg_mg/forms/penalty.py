"""The penalty of the jumps, from the largest triangle or tetrahedron that fits on each face.

A. Cangiani, E. Georgoulis, P. Houston, "hp-version discontinuous Galerkin methods on polygonal and
polyhedral meshes", M3AS 24 (2014): the inverse inequality on a face of a polygon holds with the
triangle's height in place of the polygon's diameter, however many small faces the polygon has.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from agglo_core.authoring import (
    Float,
    Int,
    Mask,
    Mesh,
    MeshError,
    OptionError,
    frozen_float,
    over_ranges,
    solvers,
)
from agglo_polydg_mg.space.solid_geometry import require_convex, solid_heights

_FEW = 10_000  # cells one thread looks at in some milliseconds

PAPER = 10.0
"""Constant C of the paper."""

Penalty = float | Literal["paper", "sharp"]
"""A constant C; ``paper`` is C = 10, ``sharp`` :func:`~agglo_polydg_mg.forms.sharp_penalty.sharp_penalty`."""


def face_penalty(mesh: Mesh, degree: int, constant: float = PAPER, natural: Int | None = None) -> Float:
    """Penalty σ = C p² max |F| / |T_F| over the two sides of each face ``(n_faces,)``, in 1 / length.

    T_F is the largest triangle with base F that lies in the cell and has its apex in one of the cell's
    vertices. On squares of side h this is 20 p² / h with C = 10. Faces of no length have σ = 0, and so
    have the ``natural`` ones (of Neumann data), which are not penalised. In 3-D T_F is the largest
    tetrahedron, or pyramid, σ = 3 C p² / h with its height h; cells must be convex.

    The search takes time that grows with the square of the number of edges of a cell: nothing for
    connected agglomerates, seconds for thousands of loose cells that are called one agglomerate.

    Raises
    ------
    MeshError
        Naming cells with a face from which no vertex is visible: they overlap themselves, or are flat. In
        3-D, cells that are not convex: the sharp penalty takes any.
    OptionError
        If ``constant`` is not positive.
    """
    if not (math.isfinite(constant) and constant > 0):
        raise OptionError(f"the penalty constant must be positive; given {constant!r}")
    heights = simplex_heights(mesh, np.ones(mesh.n_cells, bool))
    faces, sides = np.nonzero(heights == 0)
    if len(faces):
        cells = np.unique(mesh.face_cells[faces, sides])[:5].tolist()
        raise MeshError(
            f"nothing fits on face {faces[0]} in its cell: cells {cells} overlap themselves, or are flat"
        )
    sigma = constant * degree**2 * mesh.dim / heights.min(axis=1)
    if natural is not None:
        sigma[natural] = 0.0
    return frozen_float(sigma)


def simplex_heights(mesh: Mesh, cells: Mask) -> Float:
    """Heights ``(n_faces, 2)`` of the largest triangles, or tetrahedra, that fit on faces in some cells.

    ``cells (n_cells,)`` says in which; heights of others mean nothing.

    Raises
    ------
    MeshError
        In 3-D, if one of them is not convex.
    """
    if mesh.dim == 2:
        return triangle_heights(mesh)
    heights, convex = solid_heights(mesh)
    require_convex(convex | ~cells, "a constant C of the penalty (or a cell too thin for the sharp one)")
    return heights


def triangle_heights(mesh: Mesh) -> Float:
    """Height ``(n_faces, 2)`` over each face of the largest triangle in the owner and in the neighbour.

    Its base is the face, its apex a vertex of the cell, and it lies in the cell. Infinite outside the
    domain and for faces of no length; 0 if no vertex is visible from a face.
    """
    from agglo_polydg_mg.forms.triangle_kernels import largest_triangles

    heights = np.full((mesh.n_faces, 2), np.inf)
    points, (offsets, faces), sides = mesh.local_points, mesh.cell_faces, (mesh.face_pairs, mesh.face_cells)

    def write(start: int, stop: int) -> None:
        largest_triangles(points, offsets[start : stop + 1], faces, *sides, start, heights)

    over_ranges(write, mesh.n_cells, few=_FEW)
    return heights


def require_penalty(value: Any) -> None:
    """Raise OptionError unless ``value`` is ``paper``, ``sharp`` or a positive number."""
    if value in ("paper", "sharp"):
        return
    if isinstance(value, str):
        raise OptionError(f"penalty must be a positive number, 'paper' or 'sharp'; given {value!r}")
    solvers.require_positive("penalty", value)
