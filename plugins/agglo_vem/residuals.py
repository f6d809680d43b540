"""Residuals of a solution: in the cells, of fluxes, at Dirichlet data, and the stabilisation.

A. Cangiani, E. Georgoulis, T. Pryer, O. Sutton, *A posteriori error estimates for the virtual element
method*, Numer. Math. 137, 2017.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from agglo_core.authoring import Float, fields
from agglo_vem.forms import BoundaryTerms, LocalForms
from agglo_vem.local_spaces import Trace
from agglo_vem.projections import project

_TINY: Final = 1e-300
"""Smallest divisor: faces without measure have no residual."""


def squared_residuals(
    terms: BoundaryTerms, x: Float, stabilisation: str, inside: bool = True
) -> Mapping[str, Float]:
    """Return the weighted squares of all residuals of the projected solution by kind, ``(n_cells,)`` each.

    - ``cell`` and ``oscillation``, unless ``inside`` is False:
      :class:`~agglo_core.fields.residuals.CellResiduals`;
    - ``flux``: jumps of κ∇u·n between cells, and its gaps to Neumann and Robin data;
    - ``data``: gaps to the Dirichlet data on their faces, weighted by the length of the face;
    - ``stabilisation``: that term of the energy.
    """
    space = terms.space
    function = project(space, x)
    squares: dict[str, Float] = {}
    if inside:
        cell, oscillation, reach = fields.cell_residuals(space.mesh, terms.problem, space.degree, function)
        squares = {"cell": cell, "oscillation": oscillation}
    else:
        reach = fields.reach_of(space.mesh, terms.problem, space.degree)
    flux, data = _on_faces(terms, x, function, reach)
    local, rest = LocalForms(space, terms.problem, stabilisation), np.zeros(space.mesh.n_cells)
    for batch in space.batches():
        u = x[batch.unknowns]
        rest[batch.cells] = np.einsum("cn,cnm,cm->c", u, local.blocks(batch)[1], u, optimize=True)
    squares |= {"flux": flux, "data": data, "stabilisation": rest}
    return {name: np.maximum(values, 0.0) for name, values in squares.items()}


def _on_faces(
    terms: BoundaryTerms, x: Float, function: fields.Polynomials, reach: Float
) -> tuple[Float, Float]:
    """Return the weighted squares of flux residuals and of gaps to Dirichlet data ``(n_cells,)``."""
    space, mesh = terms.space, terms.space.mesh
    kappa = fields.kappa_values(mesh, terms.problem.kappa)

    def normal_flux(trace: Trace, side: int) -> tuple[Float, Float]:
        """Return κ∇u·n and n·κn at the points of a trace, from one side."""
        cells = np.repeat(mesh.face_cells[trace.faces, side], trace.points.shape[1])
        normals = np.repeat(mesh.face_normals[trace.faces], trace.points.shape[1], axis=0)
        points = trace.points.reshape(-1, mesh.dim)
        conormals = fields.times(kappa(points + mesh.origin, cells), normals)
        return (conormals * function.at(cells, points).slopes).sum(axis=1), np.maximum(
            (conormals * normals).sum(axis=1), _TINY
        )

    def add(sums: Float, trace: Trace, side: int, squares: Float) -> None:
        per_face = (trace.weights * squares).reshape(trace.points.shape[:2]).sum(axis=1)
        np.add.at(sums, mesh.face_cells[trace.faces, side], per_face)

    flux, data = np.zeros(mesh.n_cells), np.zeros(mesh.n_cells)
    # 1. Jumps of the flux between cells
    trace = space.trace(np.flatnonzero(mesh.face_cells[:, 1] >= 0))
    (own, strength), (other, other_strength) = normal_flux(trace, 0), normal_flux(trace, 1)
    for side in (0, 1):
        add(flux, trace, side, 0.5 * (own - other) ** 2 / (strength + other_strength))
    # 2. Gaps to Neumann and Robin data
    trace = terms.trace
    own, strength = normal_flux(trace, 0)
    add(flux, trace, 0, (own + terms.alpha * (trace.values @ x) - terms.natural) ** 2 / strength)
    # 3. Gaps to Dirichlet data, which the solution interpolates at nodes
    trace = space.trace(terms.parts.dirichlet)
    _, strength = normal_flux(trace, 0)
    given = fields.boundary_values(
        mesh, terms.parts.tags, terms.problem.dirichlet, trace.faces, trace.points, "dirichlet"
    )
    gaps = trace.values @ x - given.ravel()
    sizes = np.maximum(mesh.face_measures[trace.faces], _TINY) ** (1.0 / (mesh.dim - 1))
    weights = np.repeat(np.pi * space.degree / sizes, trace.points.shape[1])
    add(data, trace, 0, weights * strength * gaps**2)
    return flux * reach, data
