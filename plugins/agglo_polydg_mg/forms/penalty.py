"""Jump penalty from the largest triangle or tetrahedron that fits on each face.

A. Cangiani, E. Georgoulis, P. Houston, "hp-version discontinuous Galerkin methods on polygonal and
polyhedral meshes", M3AS 24 (2014): the inverse inequality on a polygon face holds with the triangle height
instead of the polygon diameter, however many small faces there are.
"""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from agglo_core.authoring import Float, Int, Mask, Mesh, MeshError, OptionError, frozen_float, solvers
from agglo_core.threads import COSTLY, over_ranges

PAPER = 10.0
"""The paper's constant C, without unit; a larger one gives larger jump penalties (benchmarks/penalty.py)."""

Penalty = float | Literal["paper", "sharp"]
"""A constant C; ``paper`` is C = 10, ``sharp`` :func:`~agglo_polydg_mg.forms.sharp_penalty.sharp_penalty`."""


def face_penalty(mesh: Mesh, degree: int, constant: float = PAPER, natural: Int | None = None) -> Float:
    """Return the penalty σ = C p² max |F| / |T_F| over both sides of each face ``(n_faces,)``, in 1 / length.

    T_F is the largest triangle with base F that lies in the cell and has its apex at a cell vertex. On
    squares with side h this is 20 p² / h with C = 10. Faces with length 0 have σ = 0, and so have the
    unpenalised ``natural`` faces (with Neumann data). In 3-D T_F is the largest tetrahedron or pyramid,
    σ = 3 C p² / h with its height h; cells must be convex.

    The search time grows quadratically with the edges per cell: negligible for connected agglomerates,
    seconds for an agglomerate of thousands of loose cells.

    Raises
    ------
    MeshError
        For cells with a face from which no vertex is visible: they overlap themselves, or are flat. In 3-D,
        for nonconvex cells, which only the sharp penalty accepts.
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
            f"no simplex on face {faces[0]} fits into its cell: cells {cells} overlap themselves, or are flat"
        )
    sigma = constant * degree**2 * mesh.dim / heights.min(axis=1)
    if natural is not None:
        sigma[natural] = 0.0
    return frozen_float(sigma)


def simplex_heights(mesh: Mesh, cells: Mask) -> Float:
    """Return the heights ``(n_faces, 2)`` of the largest simplices on each face inside its two cells.

    ``cells (n_cells,)`` selects the cells; heights in other cells are undefined.

    Raises
    ------
    MeshError
        In 3-D, if a selected cell is not convex.
    """
    if mesh.dim == 2:
        return triangle_heights(mesh)
    heights, convex = _solid_heights(mesh)
    dented = np.flatnonzero(cells & ~convex)[:5].tolist()
    if dented:
        raise MeshError(
            "a penalty constant C (or a cell too thin for the sharp penalty) in 3-D requires convex cells, "
            f"but cells {dented} are not convex"
        )
    return heights


def triangle_heights(mesh: Mesh) -> Float:
    """Return the heights ``(n_faces, 2)`` of the largest triangles on each edge inside its two cells.

    Its base is the face, its apex a cell vertex, and it lies in the cell. Infinite outside the domain and
    for faces with length 0; 0 if no vertex is visible from a face.
    """
    from agglo_polydg_mg.forms.triangle_kernels import largest_triangles

    heights = np.full((mesh.n_faces, 2), np.inf)
    points, (offsets, faces), sides = mesh.local_points, mesh.cell_faces, (mesh.face_pairs, mesh.face_cells)

    def write(start: int, stop: int) -> None:
        largest_triangles(points, offsets[start : stop + 1], faces, *sides, start, heights)

    over_ranges(write, mesh.n_cells, few=COSTLY)
    return heights


def _solid_heights(mesh: Mesh) -> tuple[Float, np.ndarray]:
    """Return the heights ``(n_faces, 2)`` of both cells over each face, and a mask of convex cells.

    It is the distance of the farthest vertex. In a convex cell this is the height of the largest
    tetrahedron, or pyramid, on the face inside the cell. It is infinite outside the domain and for faces
    with area 0. The mask has shape ``(n_cells,)``.
    """
    from agglo_polydg_mg.space.solid_kernels import farthest_vertices

    heights = np.full((mesh.n_faces, 2), np.inf)
    (offsets, faces), (starts, vertices) = mesh.cell_faces, mesh.cell_vertices
    middle = frozen_float(mesh.face_centroids - mesh.origin)
    of_faces = mesh.face_cells, mesh.face_normals, middle

    def write(start: int, stop: int) -> np.ndarray:
        own = offsets[start : stop + 1], faces, starts[start : stop + 1], vertices
        return np.asarray(farthest_vertices(mesh.local_points, *own, *of_faces, start, heights))

    return heights, np.concatenate(over_ranges(write, mesh.n_cells, few=COSTLY))


def require_penalty(value: Any) -> None:
    """Raise OptionError unless ``value`` is ``paper``, ``sharp`` or a positive number."""
    if value in ("paper", "sharp"):
        return
    if isinstance(value, str):
        raise OptionError(f"penalty must be a positive number, 'paper' or 'sharp'; given {value!r}")
    solvers.require_positive("penalty", value)
