"""Boundary data: which faces have Dirichlet or Neumann data, and their part of the right-hand side."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, Mesh, OptionError, frozen_int
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.quadrature import face_points, gauss, per_cell, sample

__all__ = [
    "Boundary",
    "boundary_faces",
    "boundary_values",
    "data_offset",
    "dirichlet_load",
    "dirichlet_values",
    "neumann_load",
]


class Boundary(NamedTuple):
    """Tags ``(n_faces,)`` of all faces, and the boundary faces with Dirichlet data and without (natural)."""

    tags: Int
    dirichlet: Int
    natural: Int


def boundary_faces(mesh: Mesh, problem: Diffusion) -> Boundary:
    """Faces of the boundary with Dirichlet data and without; ``tags`` are those of all faces.

    Without any data all of them are Dirichlet faces, with value 0.

    Raises
    ------
    OptionError
        For a face tag the mesh does not have, a value in both kinds of data or on no face, a component
        without Dirichlet faces.
    """
    tags = _tags(mesh, problem.boundary)
    outer = mesh.face_cells[:, 1] < 0
    present = np.unique(tags[outer]).tolist()
    both = sorted(set(problem.dirichlet) & set(problem.neumann))
    if both:
        raise OptionError(f"boundary tags {both} have Dirichlet and Neumann data: give one of them")
    unknown = sorted({*problem.dirichlet, *problem.neumann} - set(present))
    if unknown:
        raise OptionError(f"no boundary face has the tag {unknown[0]}; the boundary has the tags {present}")
    given = problem.dirichlet or problem.neumann
    dirichlet = outer & np.isin(tags, list(problem.dirichlet)) if given else outer
    natural = outer & ~dirichlet
    if natural.any():
        _require_dirichlet(mesh, dirichlet)
    return Boundary(tags, frozen_int(np.flatnonzero(dirichlet)), frozen_int(np.flatnonzero(natural)))


def _tags(mesh: Mesh, name: str) -> Int:
    """Values of the face tag ``name``; 0 if it is ``boundary`` and the mesh has no such tag."""
    if name in mesh.face_tags:
        return mesh.face_tags[name]
    if name != Diffusion.boundary:
        known = ", ".join(mesh.face_tags) or "none"
        raise OptionError(f"the mesh has no face tag {name!r} for the boundary; it has: {known}")
    return frozen_int(np.zeros(mesh.n_faces))


def _require_dirichlet(mesh: Mesh, dirichlet: np.ndarray) -> None:
    """Raise OptionError if some component of the domain has no Dirichlet face."""
    component = mesh.graph.components()
    fixed = np.zeros(int(component.max()) + 1, bool)
    fixed[component[mesh.face_cells[dirichlet, 0]]] = True
    if not fixed.all():
        cell = int(np.flatnonzero(~fixed[component])[0])
        raise OptionError(
            f"the component of cell {cell} has no boundary face with Dirichlet data: the solution is known "
            "only up to a constant there; give a value on some boundary tag (where only others have data, "
            "faces are insulated)"
        )


def boundary_values(
    mesh: Mesh, boundary: Boundary, data: Mapping[int, Field], faces: Int, points: Float, name: str
) -> Float:
    """Data ``(f, q)`` on boundary ``faces (f,)`` at ``points (f, q, 2)``, 0 where the tag has none."""
    values = np.zeros(points.shape[:2])
    for tag, field in data.items():
        on = boundary.tags[faces] == tag
        if callable(field):
            given = sample(field, points[on].reshape(-1, 2) + mesh.origin, f"{name} of tag {tag}")
            values[on] = given.reshape(-1, points.shape[1])
        else:
            cells = per_cell(field, mesh.n_cells, f"{name} of tag {tag}")
            values[on] = cells[mesh.face_cells[faces[on], 0], None]
    return values


def dirichlet_values(basis: Basis, problem: Diffusion, boundary: Boundary) -> Float:
    """Dirichlet data ``(f, q)`` at the Gauss points of ``boundary.dirichlet (f,)``."""
    if not problem.dirichlet:
        return np.zeros((len(boundary.dirichlet), basis.degree + 2))
    points = face_points(basis.mesh, boundary.dirichlet, basis.degree + 2)
    return boundary_values(basis.mesh, boundary, problem.dirichlet, boundary.dirichlet, points, "dirichlet")


def data_offset(basis: Basis, problem: Diffusion, boundary: Boundary, kappa: Float) -> Float:
    """What Dirichlet data have in common, in each cell ``(n_cells,)``.

    In each component of the domain it is the number nearest to 0 between the least and the largest of the
    data: 0 if they change sign. Only faces count whose κ is at least a hundredth of the largest: they decide
    what rounding does. A constant added to the data is added to the solution, whatever κ, and alters nothing
    else. ``kappa (n_faces, 1 or q)`` is the coefficient in the owner.
    """
    mesh, faces = basis.mesh, boundary.dirichlet
    g, component = dirichlet_values(basis, problem, boundary), mesh.graph.components()
    if not g.any():
        return np.zeros(mesh.n_cells)
    of_face, of_kappa = component[mesh.face_cells[faces, 0]], kappa[faces].max(axis=1)
    n = int(component.max()) + 1
    largest, least, most = np.zeros(n), np.full(n, np.inf), np.full(n, -np.inf)
    np.maximum.at(largest, of_face, of_kappa)
    counts = of_kappa >= 0.01 * largest[of_face]
    np.minimum.at(least, of_face[counts], g[counts].min(axis=1))
    np.maximum.at(most, of_face[counts], g[counts].max(axis=1))
    return np.asarray(np.clip(0.0, least, most)[component])


def dirichlet_load(basis: Basis, boundary: Boundary, kappa: Float, sigma: Float) -> Callable[[Float], Float]:
    """Map from data g ``(f, q)`` to its right-hand side ``(n_cells, n_local)``: ∫ σκ g v − κ g ∂v/∂n.

    g is given as by :func:`dirichlet_values`; ``kappa (n_faces, 1 or q)`` is the coefficient in the owner,
    ``sigma (n_faces,)`` the penalty.
    """
    mesh, faces = basis.mesh, boundary.dirichlet
    points, weights, tests = _traces(basis, faces)
    cells = np.repeat(mesh.face_cells[faces, 0], points.shape[1])
    slopes = basis.gradients(cells, points.reshape(-1, 2))
    normals = np.repeat(mesh.face_normals[faces], points.shape[1], axis=0)
    fluxes = np.einsum("qd,qdk->qk", normals, slopes).reshape(tests.shape)
    tests = kappa[faces][:, :, None] * (sigma[faces][:, None, None] * tests - fluxes)
    return lambda g: _gathered(basis, faces, weights * g, tests)


def neumann_load(basis: Basis, problem: Diffusion, boundary: Boundary) -> Float:
    """Right-hand side ``(n_cells, n_local)`` of Neumann data: ∫ flux v."""
    faces = boundary.natural
    points, weights, tests = _traces(basis, faces)
    g = boundary_values(basis.mesh, boundary, problem.neumann, faces, points, "neumann")
    return _gathered(basis, faces, weights * g, tests)


def _traces(basis: Basis, faces: Int) -> tuple[Float, Float, Float]:
    """Gauss points ``(f, q, 2)`` of faces, weights ``(f, q)``, values of the basis ``(f, q, n_local)``."""
    n = basis.degree + 2
    points = face_points(basis.mesh, faces, n)
    weights = basis.mesh.face_measures[faces][:, None] * gauss(n)[1] / 2
    tests = basis.values(np.repeat(basis.mesh.face_cells[faces, 0], n), points.reshape(-1, 2))
    return points, weights, tests.reshape(len(faces), n, basis.n_local)


def _gathered(basis: Basis, faces: Int, values: Float, tests: Float) -> Float:
    """Σ_q values (f, q) tests (f, q, k), summed over the faces of each cell."""
    load = np.zeros((basis.mesh.n_cells, basis.n_local))
    np.add.at(load, basis.mesh.face_cells[faces, 0], np.einsum("fq,fqk->fk", values, tests))
    return load
