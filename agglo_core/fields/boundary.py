"""Boundary faces of the elliptic problem by the kind of their data, and the data there."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from itertools import combinations
from typing import Final, NamedTuple

import numpy as np

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import OptionError
from agglo_core.fields.values import per_cell, sample
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Field

_ROUNDING: Final = 1e-6
"""Difference between exact solution and Dirichlet data, relative to their size, that counts as rounding."""


class BoundaryParts(NamedTuple):
    """Parts of the domain boundary.

    Attributes
    ----------
    tags : (n_faces,) int
        Face tags.
    dirichlet, natural : (k,) int
        Faces with Dirichlet data, and other (Neumann or Robin) faces.
    floating : (k,) int
        Components where the data determine the solution only up to a constant, by their first cells, if the
        discretisation lists them.
    """

    tags: Int
    dirichlet: Int
    natural: Int
    floating: Int = frozen_int([])


def boundary_parts(mesh: Mesh, problem: Diffusion) -> BoundaryParts:
    """Return the boundary faces with and without Dirichlet data, and all face tags.

    Without any data all boundary faces are Dirichlet faces, with value 0.

    Raises
    ------
    OptionError
        For an unknown face tag, or a value in two kinds of data or on no face.
    """
    kinds_of_data = {"Dirichlet": problem.dirichlet, "Neumann": problem.neumann, "Robin": problem.robin}
    for one, other in combinations(kinds_of_data, 2):
        conflicts = sorted(set(kinds_of_data[one]) & set(kinds_of_data[other]))
        if conflicts:
            raise OptionError(
                f"boundary tags {conflicts} have both {one} and {other} data: give only one of them"
            )
    return split_boundary(mesh, problem.boundary, problem.dirichlet, {*problem.neumann, *problem.robin})


def split_boundary(mesh: Mesh, name: str, fixed: Collection[int], free: Collection[int]) -> BoundaryParts:
    """Split the boundary by the values of the face tag ``name`` with fixed data, and with other data.

    Without any data all boundary faces are fixed, otherwise faces without data are free.

    Raises
    ------
    OptionError
        For an unknown face tag, or a value on no face.
    """
    tags, outer, kinds = _tags(mesh, name), mesh.face_cells[:, 1] < 0, mesh.boundary_kinds
    present = np.unique(kinds.tags.get(name, np.zeros_like(kinds.component))).tolist()
    unknown = sorted({*fixed, *free} - set(present))
    if unknown:
        raise OptionError(f"no boundary face has the tag {unknown[0]}; the boundary has the tags {present}")
    dirichlet = outer & np.isin(tags, list(fixed)) if fixed or free else outer
    sets = frozen_int(np.flatnonzero(dirichlet)), frozen_int(np.flatnonzero(outer & ~dirichlet))
    return BoundaryParts(tags, *sets)


def _tags(mesh: Mesh, name: str) -> Int:
    """Return the values of the face tag ``name``, all 0 if the default tag is absent."""
    if name in mesh.face_tags:
        return mesh.face_tags[name]
    if name != Diffusion.boundary:
        known = ", ".join(mesh.face_tags) or "none"
        raise OptionError(f"the mesh has no face tag {name!r} for the boundary; it has: {known}")
    return frozen_int(np.zeros(mesh.n_faces))


def boundary_values(
    mesh: Mesh, tags: Int, data: Mapping[int, Field], faces: Int, points: Float, name: str
) -> Float:
    """Evaluate boundary data ``(t, q)`` at ``points (t, q, d)`` on ``faces (t,)``, 0 without data."""
    values = np.zeros(points.shape[:2])
    for tag, field in data.items():
        on = tags[faces] == tag
        if callable(field):
            given = sample(field, points[on].reshape(-1, mesh.dim) + mesh.origin, f"{name} of tag {tag}")
            values[on] = given.reshape(-1, points.shape[1])
        else:
            cells = per_cell(field, mesh.n_cells, f"{name} of tag {tag}")
            values[on] = cells[mesh.face_cells[faces[on], 0], None]
    return values


def natural_values(mesh: Mesh, tags: Int, problem: Diffusion, faces: Int, points: Float) -> Float:
    """Evaluate Neumann data and g of Robin data ``(t, q)`` at points on faces, as :func:`boundary_values`."""
    flux = boundary_values(mesh, tags, problem.neumann, faces, points, "neumann")
    return flux + boundary_values(mesh, tags, robin_data(problem, 1), faces, points, "robin")


def robin_alpha(mesh: Mesh, tags: Int, problem: Diffusion, faces: Int, points: Float) -> Float:
    """Evaluate α of Robin data ``(t, q)`` at points on faces, 0 without Robin data.

    Raises
    ------
    OptionError
        For a negative value, with tag and face.
    """
    alpha = boundary_values(mesh, tags, robin_data(problem, 0), faces, points, "alpha of robin")
    if alpha.size and alpha.min() < 0.0:
        piece = int(np.argmin(alpha.min(axis=1)))
        raise OptionError(
            f"alpha of robin must not be negative: it is {alpha[piece].min():g} on face {faces[piece]} with "
            f"tag {tags[faces[piece]]}"
        )
    return alpha


def robin_data(problem: Diffusion, which: int) -> Mapping[int, Field]:
    """Return α (0) or g (1) of the Robin data by tag."""
    return {tag: pair[which] for tag, pair in problem.robin.items()}


def require_exact(mesh: Mesh, exact: Callable[[Float], Float], points: Float, data: Float) -> None:
    """Raise OptionError if the exact solution differs from Dirichlet ``data (q,)`` at boundary points.

    ``points (q, d)`` are relative to the mesh origin. Rounding is relative to the values, and to those inside
    where both nearly vanish.
    """
    if not len(data):
        return
    points = points + mesh.origin
    values = sample(exact, points, "exact")
    worst = int(np.argmax(np.abs(values - data)))
    gap = abs(values[worst] - data[worst])
    if gap <= _ROUNDING * max(np.abs(values).max(), np.abs(data).max()):
        return
    if gap > _ROUNDING * np.abs(sample(exact, mesh.cell_centroids, "exact")).max():
        place = ", ".join(f"{x:g}" for x in points[worst])
        raise OptionError(
            f"exact contradicts the Dirichlet data: at the boundary point ({place}) it is {values[worst]:g}, "
            f"the data are {data[worst]:g}; pass the exact values as Dirichlet data, or no exact solution"
        )
