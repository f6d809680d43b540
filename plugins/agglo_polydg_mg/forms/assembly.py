"""Symmetric interior penalty discretisation of −∇·(κ∇u) + b·∇u + c u = f on polygons and polyhedra.

a(u, v) = Σ_K ∫ κ∇u·∇v + c u v − Σ_F ∫ ({κ∇u}·[v] + {κ∇v}·[u]) + Σ_F γ_F σ_F ∫ [u][v], boundary faces with
Dirichlet data included (Nitsche). If κ jumps, averages are weighted with κ from the other side and γ is the
harmonic mean (A. Ern, A. Stephansen, P. Zunino, IMA J. Numer. Anal. 29, 2009), so that the constants do not
depend on the ratio; for κ = 1 averages are arithmetic and γ = 1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.authoring import (
    Diffusion,
    Field,
    Float,
    Int,
    Mesh,
    System,
    frozen_float,
    frozen_int,
)
from agglo_core.fields.boundary import BoundaryParts
from agglo_core.fields.coefficients import positive
from agglo_core.fields.gauss_points import gauss
from agglo_core.fields.tensors import Tensor
from agglo_core.threads import COSTLY, over_ranges
from agglo_polydg_mg.forms.boundary import (
    boundary_faces,
    data_offset,
    dirichlet_load,
    dirichlet_values,
    natural_load,
    robin_terms,
    rule_of,
)
from agglo_polydg_mg.forms.coefficients import cell_means, reaction_blocks
from agglo_polydg_mg.forms.convection import add_convection, inflow_load
from agglo_polydg_mg.forms.face_quadrature import OnFaces, all_faces, on_both_sides
from agglo_polydg_mg.forms.floating import balanced, floating_parts, hold
from agglo_polydg_mg.forms.penalty import PAPER, Penalty, face_penalty
from agglo_polydg_mg.forms.sharp_penalty import largest_per_face, sharp_penalty
from agglo_polydg_mg.forms.side_sums import add_sides
from agglo_polydg_mg.space.basis import Basis, stiffness


def discretise(
    mesh: Mesh, degree: int, problem: Diffusion, *, penalty: Penalty = PAPER, scaled_basis: bool = False
) -> System:
    """Assemble matrix and right-hand side for a diffusion problem, with polynomials of degree p per cell.

    Parameters
    ----------
    mesh : Mesh
        Cells may have any shape.
    degree : int
        p, 1..6.
    problem : Diffusion
        Boundary data refer to the face tag ``problem.boundary``. Without data, u = 0 on the
        whole boundary; otherwise faces without data are insulated. A callable κ is sampled inside the cells
        and just inside their faces, so it may jump between cells.
    penalty : float, "paper" or "sharp"
        Constant C for :func:`~agglo_polydg_mg.forms.penalty.face_penalty`, 10 in the paper; or
        :func:`~agglo_polydg_mg.forms.sharp_penalty.sharp_penalty`.
    scaled_basis : bool
        See :class:`~agglo_polydg_mg.space.basis.Basis`.

    Raises
    ------
    MeshError
        For degenerate cells; in 3-D, with a constant C, for nonconvex cells.
    OptionError
        For a degree outside 1..6, nonpositive κ, a negative reaction, data with nonfinite values or the
        wrong shape, tags missing on the boundary, or a domain component without Dirichlet faces, reaction
        and positive α on which source and fluxes do not balance.

    Notes
    -----
    On such a component u is unique only up to a constant. A number added to one diagonal entry keeps the
    matrix positive definite. The solution of the system is a solution of the problem; its mean there is
    not 0 (:meth:`~agglo_polydg_mg.polydg.PolyDG.means`).
    """
    return discretise_lifted(mesh, degree, problem, penalty=penalty, scaled_basis=scaled_basis).system


class Lifted(NamedTuple):
    """Linear system for u, and its right-hand side for u − c with a constant c in each cell.

    Attributes
    ----------
    system : System
    load : (n,) float
        b − A c, computed from the data g − c and so without cancellation; b itself if c = 0.
    offset : (n,) float
        Coefficients of c.
    sigma : (n_faces,) float
        Jump penalty.
    """

    system: System
    load: Float
    offset: Float
    sigma: Float


def discretise_lifted(
    mesh: Mesh,
    degree: int,
    problem: Diffusion,
    *,
    penalty: Penalty = PAPER,
    scaled_basis: bool = False,
    basis: Basis | None = None,
    kept: tuple[Any, Float] | None = None,
) -> Lifted:
    """Assemble as :func:`discretise` does, and also return the load for u − c, c from :func:`data_offset`.

    A ``basis`` from an earlier problem with this mesh and degree keeps the purely geometric data. Matrix and
    penalty may be ``kept`` from an earlier problem if only data differ.
    """
    # 1. Check the data
    basis = basis or Basis(mesh, degree, scaled_basis)
    boundary = boundary_faces(mesh, problem)
    kappa = positive(mesh, problem.kappa)
    # 2. Penalty and matrix
    A, sigma = kept or _matrix_and_penalty(basis, problem, boundary, penalty, kappa)
    # 3. Load and Dirichlet data
    parts = floating_parts(basis, boundary)
    loads = load(basis, problem).reshape(mesh.n_cells, -1)
    loads = balanced(basis, problem, boundary, parts, loads)
    g = dirichlet_values(basis, problem, boundary)
    offsets = frozen_int(np.arange(mesh.n_cells + 1) * basis.n_local)
    if not g.any():
        b = frozen_float(loads.ravel())
        return Lifted(System.trusted(A, b, offsets, mesh), b, frozen_float(np.zeros(basis.n)), sigma)
    held = on_both_sides(mesh, kappa, boundary.dirichlet, degree + 2)
    diffusive, inflow = dirichlet_load(basis, boundary, held, sigma), inflow_load(basis, problem, boundary)

    def functional(data: Float) -> Float:
        return diffusive(data) if inflow is None else diffusive(data) + inflow(data)

    b = frozen_float((loads + functional(g)).ravel())
    system = System.trusted(A, b, offsets, mesh)
    # 4. Load without the Dirichlet offset
    c = data_offset(basis, problem, boundary, held.kappa[:, 0])
    if not c.any():
        return Lifted(system, b, frozen_float(np.zeros(basis.n)), sigma)
    shifted_load = functional(g - c[mesh.face_cells[rule_of(basis, boundary.dirichlet).faces, 0], None])
    return Lifted(system, frozen_float((loads + shifted_load).ravel()), basis.constants(c), sigma)


def _matrix_and_penalty(
    basis: Basis, problem: Diffusion, boundary: BoundaryParts, penalty: Penalty, kappa: Field | Tensor
) -> tuple[Any, Float]:
    mesh = basis.mesh
    on_faces = on_both_sides(mesh, kappa, all_faces(mesh), basis.degree + 2)
    inside = stiffness(basis, kappa)
    sigma = jump_penalty(basis, kappa, penalty, boundary.natural, on_faces, inside)
    A = _matrix(basis, inside, on_faces, sigma, reaction_blocks(basis, problem.reaction))
    robin = robin_terms(basis, problem, boundary)
    if robin is not None:
        robin.add_to(A.data, basis.pattern[2])
    hold(basis, kappa, floating_parts(basis, boundary), A.data, basis.pattern[2])
    add_convection(basis, problem, boundary, A.data)
    return A, sigma


def load(basis: Basis, problem: Diffusion) -> Float:
    """Return the load vector ``(n,)`` of source, Neumann and Robin data: b without Dirichlet terms.

    Its product with the coefficients of u is the load work, ∫ f u + ∫ flux u.
    """
    source = basis.weighted_moments(problem.source, basis.degree, "source") * basis.scale[:, None]
    if problem.neumann or problem.robin:
        source += natural_load(basis, problem, boundary_faces(basis.mesh, problem))
    return frozen_float(source.ravel())


def jump_penalty(
    basis: Basis,
    kappa: Field | Tensor,
    penalty: Penalty,
    natural: Int,
    on_faces: OnFaces | None = None,
    inside: Float | None = None,
) -> Float:
    """Return each face's jump penalty σ ``(n_faces,)``, 0 on ``natural`` (Neumann) faces.

    κ comes from :func:`positive`. If available, pass :func:`on_both_sides` for degree + 2 as
    ``on_faces``, and its :func:`stiffness` as ``inside``.
    """
    if penalty != "sharp":
        constant = PAPER if penalty == "paper" else penalty
        return face_penalty(basis.mesh, basis.degree, constant, natural)
    if on_faces is None:
        on_faces = on_both_sides(basis.mesh, kappa, all_faces(basis.mesh), basis.degree + 2)
    if inside is None:
        inside = stiffness(basis, kappa)
    return sharp_penalty(basis, kappa, on_faces, inside, natural)


def effective_penalty(basis: Basis, problem: Diffusion, sigma: Float) -> Float:
    """Return the penalty ``(n_faces,)`` that gives jumps their energy with the cell means of κ.

    Choices of the solver use one κ per cell. For a tensor σ is multiplied by the harmonic mean of n·κn over
    that of the means, so that faces across its weak directions count as weak.
    """
    mesh = basis.mesh
    kappa = positive(mesh, problem.kappa)
    if not isinstance(kappa, Tensor):
        return sigma
    faces, means = all_faces(mesh), cell_means(mesh, kappa)
    rows = on_both_sides(mesh, kappa, faces, basis.degree + 2).kappa
    strength = (rows[:, 0] * rows[:, 1] / (rows[:, 0] + rows[:, 1])).max(axis=1)
    strength = largest_per_face(strength, mesh)
    one, other = means[mesh.face_cells[:, 0]], means[mesh.face_cells[:, 1]]
    other = np.where(mesh.face_cells[:, 1] < 0, one, other)
    return frozen_float(sigma * strength * (one + other) / (one * other))


def _matrix(
    basis: Basis, inside: Float, on_faces: OnFaces, sigma: Float, reaction: Float | None
) -> sparse.bsr_array:
    from agglo_polydg_mg.forms.face_kernels import face_blocks

    # 1. Stiffness and reaction on the diagonal blocks
    mesh = basis.mesh
    count = on_faces.kappa.shape[2]
    rule = gauss(basis.degree + 1 if count == 1 else count)
    indptr, indices, diagonal, slots = basis.pattern
    blocks = np.zeros((len(indices), basis.n_local, basis.n_local))
    blocks[diagonal] = inside
    if reaction is not None:
        blocks[diagonal] += reaction
    across, cells = basis.across, mesh.face_cells if mesh.dim == 2 else basis.sides.cells

    def add(start: int, stop: int) -> None:
        """Add the face terms to the matrix rows of the cells in one mesh strip.

        Only faces between two strips are visited twice.
        """
        in_strip = np.zeros(mesh.n_cells + 1, bool)  # last entry: outside
        in_strip[across[start:stop]] = True
        faces = frozen_int(np.flatnonzero(in_strip.take(cells).any(axis=1)))
        if mesh.dim == 3:
            add_sides(basis, faces, in_strip, sigma, on_faces, blocks)
        else:
            form_data = *frames, sigma, *on_faces, *rule
            face_blocks(points, pairs, cells, faces, in_strip, slots, *form_data, blocks)

    # 2. Faces, strip by strip
    points, pairs = mesh.local_points, mesh.face_pairs if mesh.dim == 2 else None
    frames = basis.boxes, basis.scale
    over_ranges(add, mesh.n_cells, few=COSTLY, shares=1)
    return sparse.bsr_array((blocks, indices, indptr), shape=(basis.n, basis.n))
