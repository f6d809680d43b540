"""Components of the domain where data determine the solution only up to a constant."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Diffusion, Field, Float, Int, frozen_float, frozen_int
from agglo_core.fields.boundary import BoundaryParts
from agglo_core.fields.floating import Floating, magnitude
from agglo_core.fields.tensors import Tensor
from agglo_polydg_mg.forms.boundary import natural_sizes
from agglo_polydg_mg.forms.coefficients import cell_means
from agglo_polydg_mg.space.basis import Basis


def floating_parts(basis: Basis, boundary: BoundaryParts) -> Floating | None:
    """Return the components where the solution is determined only up to a constant, None without any."""
    if not len(boundary.floating):
        return None
    mesh, component = basis.mesh, basis.mesh.graph.components()
    parts = [frozen_int(np.flatnonzero(component == component[cell])) for cell in boundary.floating]
    unknowns = [
        frozen_int((cells[:, None] * basis.n_local + np.arange(basis.n_local)).ravel()) for cells in parts
    ]
    unit = basis.weighted_moments(1.0, basis.degree, "1") * basis.scale[:, None]
    return Floating(mesh, parts, unknowns, basis.constants(np.ones(mesh.n_cells)), frozen_float(unit.ravel()))


def hold(basis: Basis, kappa: Field | Tensor, floating: Floating | None, blocks: Float, places: Int) -> None:
    """Add a number to one diagonal entry of the matrix ``blocks`` for each floating component.

    The entry is that of the constant in the cell with the largest κ.
    """
    if floating is not None:
        for cell, energy in floating.energies(cell_means(basis.mesh, kappa)):
            blocks[places[cell], 0, 0] += energy / floating.ones[cell * basis.n_local] ** 2


def balanced(
    basis: Basis, problem: Diffusion, boundary: BoundaryParts, floating: Floating | None, loads: Float
) -> Float:
    """Return the loads ``(n_cells, n_local)`` with zero sum on each floating component.

    Raises
    ------
    OptionError
        If source and fluxes do not balance, with their integral.
    """
    if floating is None:
        return loads
    sizes = cell_means(basis.mesh, magnitude(problem.source), "source") * basis.mesh.cell_measures
    sizes = sizes + natural_sizes(basis, problem, boundary)
    return floating.balanced(loads.ravel(), sizes).reshape(loads.shape)
