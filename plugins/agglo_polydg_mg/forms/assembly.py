"""Symmetric interior penalty discretisation of −∇·(κ∇u) = f on polygons and polyhedra.

a(u, v) = Σ_K ∫ κ∇u·∇v − Σ_F ∫ ({κ∇u}·[v] + {κ∇v}·[u]) + Σ_F γ_F σ_F ∫ [u][v], boundary faces with
Dirichlet data included (Nitsche). Where κ jumps, averages are weighted with the κ of the other side and
γ is the harmonic mean (A. Ern, A. Stephansen, P. Zunino, IMA J. Numer. Anal. 29, 2009), so that the
constants do not depend on the ratio; for κ = 1 averages are arithmetic and γ = 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.authoring import (
    Diffusion,
    Field,
    Float,
    Int,
    Mesh,
    OptionError,
    System,
    frozen_float,
    frozen_int,
    over_ranges,
)
from agglo_polydg_mg.forms.boundary import (
    boundary_faces,
    data_offset,
    dirichlet_load,
    dirichlet_values,
    neumann_load,
    rule_of,
)
from agglo_polydg_mg.forms.face_quadrature import all_faces, face_coefficients
from agglo_polydg_mg.forms.penalty import PAPER, Penalty, face_penalty
from agglo_polydg_mg.forms.sharp_penalty import sharp_penalty
from agglo_polydg_mg.forms.side_sums import add_sides
from agglo_polydg_mg.forms.unit_forms import UnitForms
from agglo_polydg_mg.space.basis import Basis, stiffness
from agglo_polydg_mg.space.gauss_points import gauss
from agglo_polydg_mg.space.quadrature import per_cell, sample, weighted_moments

_FEW = 4_000  # cells whose blocks one thread adds up in some ten milliseconds


def discretise(
    mesh: Mesh, degree: int, problem: Diffusion, *, penalty: Penalty = PAPER, scaled_basis: bool = False
) -> System:
    """Matrix and right-hand side of a diffusion problem with polynomials of degree p on each cell.

    Parameters
    ----------
    mesh : Mesh
        Cells of any shape.
    degree : int
        p, 1..6.
    problem : Diffusion
        Dirichlet and Neumann data refer to the face tag ``problem.boundary``. Without any u = 0 on the
        whole boundary; with some, faces that have none are insulated. A callable κ is sampled inside the
        cells and just inside their faces, so it may jump between cells.
    penalty : float, "paper" or "sharp"
        Constant C of :func:`~agglo_polydg_mg.forms.penalty.face_penalty`, 10 in the paper; or
        :func:`~agglo_polydg_mg.forms.sharp_penalty.sharp_penalty`.
    scaled_basis : bool
        See :class:`~agglo_polydg_mg.space.basis.Basis`.

    Raises
    ------
    MeshError
        For degenerate cells; in 3-D, with a constant C, for cells that are not convex.
    OptionError
        For a degree outside 1..6, κ that is not positive, data that are not finite or of another
        shape, tags the boundary does not have, a component of the domain without Dirichlet faces
        (the solution would be known up to a constant only).
    """
    return lifted(mesh, degree, problem, penalty=penalty, scaled_basis=scaled_basis).system


class Lifted(NamedTuple):
    """A system, and the same for u − c, c being the offset of the Dirichlet data in each cell.

    Attributes
    ----------
    system : System
    load : (n,) float
        b − A c, from data g − c and so without the rounding of what cancels; b itself if c = 0.
    offset : (n,) float
        Coefficients of c.
    sigma : (n_faces,) float
        Penalty of the jumps.
    """

    system: System
    load: Float
    offset: Float
    sigma: Float


def lifted(
    mesh: Mesh,
    degree: int,
    problem: Diffusion,
    *,
    penalty: Penalty = PAPER,
    scaled_basis: bool = False,
    basis: Basis | None = None,
    units: UnitForms | None = None,
) -> Lifted:
    """As :func:`discretise`, together with the load that is left without the :func:`data_offset`.

    A ``basis`` of an earlier problem, of that mesh and degree, keeps what is geometry alone; ``units`` keep
    what κ scales too, where it is one number in each cell.
    """
    basis = basis or Basis(mesh, degree, scaled_basis)
    boundary = boundary_faces(mesh, problem)
    kappa = positive(mesh, problem.kappa)
    kept = units if units is not None and units.fit and not callable(kappa) else None
    on_faces = face_coefficients(mesh, kappa, all_faces(mesh), degree + 2)
    inside = stiffness(basis, kappa) if kept is None else None
    sigma = jump_penalty(basis, kappa, penalty, boundary.natural, on_faces, inside, kept)
    A = _matrix(basis, inside, on_faces, sigma, kappa, kept)
    loads = load(basis, problem).reshape(mesh.n_cells, -1)
    g = dirichlet_values(basis, problem, boundary)
    offsets = frozen_int(np.arange(mesh.n_cells + 1) * basis.n_local)
    if not g.any():
        b = frozen_float(loads.ravel())
        return Lifted(System.trusted(A, b, offsets, mesh), b, frozen_float(np.zeros(basis.n)), sigma)
    own = face_coefficients(mesh, kappa, boundary.dirichlet, degree + 2)[:, 0]
    functional = dirichlet_load(basis, boundary, own, sigma)
    b = frozen_float((loads + functional(g)).ravel())
    system = System.trusted(A, b, offsets, mesh)
    c = data_offset(basis, problem, boundary, own)
    if not c.any():
        return Lifted(system, b, frozen_float(np.zeros(basis.n)), sigma)
    rest = functional(g - c[mesh.face_cells[rule_of(basis, boundary.dirichlet).faces, 0], None])
    return Lifted(system, frozen_float((loads + rest).ravel()), basis.constants(c), sigma)


def load(basis: Basis, problem: Diffusion) -> Float:
    """Load ``(n,)`` of source and Neumann data: b without the terms of Dirichlet data.

    Its product with the coefficients of u is the work of the loads, ∫ f u + ∫ flux u.
    """
    source = basis.weighted_moments(problem.source, basis.degree, "source") * basis.scale[:, None]
    if problem.neumann:
        source += neumann_load(basis, problem, boundary_faces(basis.mesh, problem))
    return frozen_float(source.ravel())


def jump_penalty(
    basis: Basis,
    kappa: Field,
    penalty: Penalty,
    natural: Int,
    on_faces: Float | None = None,
    inside: Float | None = None,
    units: UnitForms | None = None,
) -> Float:
    """Penalty σ of each face ``(n_faces,)``, 0 on ``natural`` ones, for κ as :func:`positive` returns it.

    ``on_faces`` are its :func:`face_coefficients` for degree + 2, ``inside`` its :func:`stiffness`, where
    they are at hand; so are ``units``, if κ is one number in each cell.
    """
    if penalty != "sharp":
        constant = PAPER if penalty == "paper" else penalty
        return face_penalty(basis.mesh, basis.degree, constant, natural)
    if on_faces is None:
        on_faces = face_coefficients(basis.mesh, kappa, all_faces(basis.mesh), basis.degree + 2)
    if inside is None and units is None:
        inside = stiffness(basis, kappa)
    return sharp_penalty(basis, kappa, on_faces, inside, natural, units)


def _matrix(
    basis: Basis, inside: Float | None, on_faces: Float, sigma: Float, kappa: Field, units: UnitForms | None
) -> sparse.bsr_array:
    from agglo_polydg_mg.forms.face_kernels import face_blocks, scaled_blocks

    mesh = basis.mesh
    rule = gauss(basis.degree + 1 if on_faces.shape[2] == 1 else on_faces.shape[2])
    indptr, indices, diagonal, slots = basis.pattern
    blocks = np.zeros((len(indices), basis.n_local, basis.n_local))
    if inside is not None:
        blocks[diagonal] = inside
    across, cells = basis.across, mesh.face_cells if mesh.dim == 2 else basis.sides.cells

    def add(start: int, stop: int) -> None:
        """Rows of the cells of one strip of the mesh; only faces between two strips are looked at twice."""
        mine = np.zeros(mesh.n_cells + 1, bool)  # the last one is outside
        mine[across[start:stop]] = True
        faces = frozen_int(np.flatnonzero(mine.take(cells).any(axis=1)))
        if mesh.dim == 3:
            add_sides(basis, faces, mine, sigma, on_faces, blocks)
        elif units is None:
            face_blocks(points, pairs, cells, faces, mine, slots, *frames, sigma, on_faces, *rule, blocks)
        else:
            parts = slots, diagonal, sigma, frozen_float(kappa), units.stiffness, units.faces
            scaled_blocks(cells, faces, mine, *parts, blocks)

    points, pairs = mesh.local_points, mesh.face_pairs if mesh.dim == 2 else None
    frames = basis.boxes, basis.scale
    over_ranges(add, mesh.n_cells, few=_FEW, shares=1)
    return sparse.bsr_array((blocks, indices, indptr), shape=(basis.n, basis.n))


def positive(mesh: Mesh, kappa: Field) -> Field:
    """κ as ``(n_cells,)`` values or as a callable, which raises OptionError where it is not positive."""
    if callable(kappa):

        def checked(points: Float) -> Float:
            values = sample(kappa, points, "kappa")
            worst = int(np.argmin(values))
            if not values[worst] > 0:
                raise OptionError(
                    f"kappa must be positive: it is {values[worst]} at {points[worst].tolist()}"
                )
            return values

        return checked
    values = per_cell(kappa, mesh.n_cells, "kappa")
    worst = int(np.argmin(values))
    if not values[worst] > 0:
        raise OptionError(f"kappa must be positive: it is {values[worst]} in cell {worst}")
    return values


def cell_means(mesh: Mesh, field: Field) -> Float:
    """Mean of κ over each cell ``(n_cells,)``."""
    if not callable(field):
        return per_cell(field, mesh.n_cells, "kappa")
    unit = [0.0, 0.0, 1.0, 1.0, 1.0, 0.0] if mesh.dim == 2 else [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    boxes = np.tile(unit, (mesh.n_cells, 1))
    integrals = weighted_moments(mesh, field, boxes, 0, "kappa")[:, 0]
    return frozen_float(2.0 ** (0.5 * mesh.dim) * integrals / mesh.cell_measures)  # L₀ is the root of 1/2
