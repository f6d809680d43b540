"""Discretisation PolyDG: matrices, loads, sample values and error norms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from agglo_core.authoring import (
    Diffusion,
    Elasticity,
    Field,
    Float,
    Int,
    Mask,
    Mesh,
    OptionError,
    Problem,
    Quadrature,
    Samples,
    System,
    frozen_float,
    solvers,
)
from agglo_core.fields.coefficients import is_zero, positive
from agglo_core.fields.corrections import corrections
from agglo_polydg_mg.elasticity.discretisation import PolyDGElasticity
from agglo_polydg_mg.forms.assembly import Lifted, discretise_lifted, effective_penalty, load
from agglo_polydg_mg.forms.boundary import boundary_faces, largest_alpha, require_consistent
from agglo_polydg_mg.forms.coefficients import cell_means, reaction_blocks
from agglo_polydg_mg.forms.convection import mean_speed
from agglo_polydg_mg.forms.floating import floating_parts
from agglo_polydg_mg.forms.fluxes import fluxes
from agglo_polydg_mg.forms.norms import EnergyNorm, errors
from agglo_polydg_mg.forms.penalty import PAPER, Penalty, require_penalty
from agglo_polydg_mg.forms.residuals import squared_residuals
from agglo_polydg_mg.forms.sides import with_straight_sides
from agglo_polydg_mg.solver.choose import choose
from agglo_polydg_mg.space.basis import Basis, stiffness
from agglo_polydg_mg.space.projection import transfer
from agglo_polydg_mg.space.sampling import cell_integrals, evaluate, gradient, quadrature, samples_of


class Kept(NamedTuple):
    """Matrix, penalty ``(n_faces,)`` and energy norm of an earlier problem with an equal matrix."""

    matrix: Any
    penalty: Float
    norm: EnergyNorm | None


@dataclass(frozen=True)
class PolyDG:
    """Discretise diffusion problems by a discontinuous Galerkin method on polygons and polyhedra.

    Implements :class:`~agglo_core.problems.Discretisation`.

    Attributes
    ----------
    degree : int
        Polynomial degree, 1..6.
    penalty : float, "paper" or "sharp"
        Constant C of the jump penalty; ``paper`` is C = 10, ``sharp`` the smallest penalty that is
        provably coercive: :func:`~agglo_polydg_mg.forms.sharp_penalty.sharp_penalty`.
    scaled_basis : bool
        Scale the basis by the bounding box size, and rotate the boxes of flat cells. The
        paper's basis has neither.

    Raises
    ------
    OptionError
        For any other value.
    """

    accepts: ClassVar[tuple[str, ...]] = (Diffusion.kind,)

    degree: int = 1
    penalty: Penalty = "sharp"
    scaled_basis: bool = True

    def __post_init__(self) -> None:
        solvers.require_count("degree", self.degree, 1, 6)
        require_penalty(self.penalty)
        solvers.require_truth("scaled_basis", self.scaled_basis)

    def of_kind(self, kind: str) -> Any:
        """Return the discretisation for problems of a kind: another one for elasticity, else this one.

        Elasticity has its own penalty and basis scaling: only the degree is taken.

        Raises
        ------
        OptionError
            For elasticity, if the penalty is neither a default nor ``sharp``.
        """
        if kind != Elasticity.kind:
            return self
        if self.penalty not in (PAPER, "paper", "sharp"):
            raise OptionError(
                f"elasticity has its own jump penalty; given penalty = {self.penalty!r}, expected 'sharp'"
            )
        return PolyDGElasticity(self.degree)

    def basis(self, mesh: Mesh) -> Basis:
        """Return the discontinuous polynomial basis on a mesh.

        With the sharp penalty, in 2-D, collinear edges between two cells are merged into one side.
        """
        seen = with_straight_sides(mesh) if self.penalty == "sharp" else mesh
        return Basis(seen, self.degree, self.scaled_basis)

    def check(self, problem: Problem, mesh: Mesh) -> None:
        """Raise OptionError if the boundary data do not fit the mesh or the exact solution."""
        self.basis(mesh)
        boundary_faces(mesh, _diffusion(problem))
        require_consistent(mesh, _diffusion(problem), self.degree)

    def assemble(self, problem: Problem, mesh: Mesh) -> System:
        """Assemble matrix and right-hand side of a problem on a mesh.

        The matrix is symmetric unless the problem has convection.
        See :func:`~agglo_polydg_mg.forms.assembly.discretise`.
        """
        return self.lifted(problem, mesh).system

    def lifted(
        self, problem: Problem, mesh: Mesh, basis: Basis | None = None, kept: Kept | None = None
    ) -> Lifted:
        """Return the system on a mesh, and its load for u − c with a constant c in each cell.

        The constants come from the Dirichlet data. The :meth:`basis` of an earlier problem on the mesh saves
        the purely geometric work. If its matrix is equal, it may be ``kept``.
        """
        diffusion, basis = _diffusion(problem), basis or self.basis(mesh)
        require_consistent(mesh, diffusion, self.degree)
        found = discretise_lifted(
            basis.mesh,
            self.degree,
            diffusion,
            penalty=self.penalty,
            basis=basis,
            kept=kept and (kept.matrix, kept.penalty),
        )
        if basis.mesh is mesh:
            return found
        system = System.trusted(found.system.A, found.system.b, found.system.block_offsets, mesh)
        return found._replace(system=system)

    def fine_system(
        self, problem: Problem, mesh: Mesh, basis: Basis | None = None, kept: Kept | None = None
    ) -> solvers.FineSystem:
        """Return the system on a mesh in the form that solvers require.

        ``basis``, and with an equal matrix ``kept``, may come from an earlier problem.

        Raises
        ------
        OptionError
            See :func:`~agglo_polydg_mg.forms.assembly.discretise`; also for values that are not finite.
        """
        # 1. Discretise
        diffusion, basis = _diffusion(problem), basis or self.basis(mesh)
        system, load, offset, sigma = self.lifted(diffusion, mesh, basis, kept)
        # 2. Rescale data of extreme size, and discretise again
        factor = solvers.factor_for(float(np.abs(load).max()) or solvers.data_size(mesh, diffusion))
        if factor != 1.0:
            diffusion = solvers.times(diffusion, factor)
            system, load, offset, sigma = self.lifted(diffusion, mesh, basis, kept)
        if not (_finite(system.b) and _finite(system.A.data)):
            raise OptionError("the matrix or the right-hand side contains values that are not finite")
        return solvers.FineSystem(
            system.A,
            load,
            basis.n_local,
            self.residual_measure(diffusion, mesh, load, basis, kept and kept.norm),
            full=system.b,
            offset=offset if offset.any() else None,
            factor=factor,
            sigma=effective_penalty(basis, diffusion, sigma),
            penalty=sigma,
            meaning=(self, mesh, problem),
            means=self.means(diffusion, mesh, basis),
        )

    def means(
        self, problem: Problem, mesh: Mesh, basis: Basis | None = None
    ) -> Callable[[Float], Float] | None:
        """Return a map from unknowns to their means, where the solution is unique only up to a constant.

        The result ``(n,)`` of the map is constant on such components and 0 elsewhere; solvers subtract it.
        None if the solution is unique.
        """
        basis = basis or self.basis(mesh)
        floating = floating_parts(basis, boundary_faces(basis.mesh, _diffusion(problem)))
        return None if floating is None else floating.means

    def matrix_kind(self, problem: Problem, fine: solvers.FineSystem) -> str:
        """Return the kind of matrix, by which solvers recommend multigrid or a direct method."""
        assert fine.meaning is not None  # set by fine_system
        assert fine.sigma is not None
        mesh = self.basis(fine.meaning[1]).mesh
        return choose(mesh, fine.sigma, cell_means(mesh, _diffusion(problem).kappa), self.degree).kind

    def coarse_operator(self, problem: Problem, mesh: Mesh, labels: Int) -> Any:
        """Rediscretise on agglomerates, with the penalty and the means of the coefficients computed there."""
        return self.assemble(corrections(_diffusion(problem), mesh, labels), mesh.coarsen(labels)).A

    def project(self, mesh: Mesh, function: Field) -> Float:
        """Return the coefficients ``(n,)`` of a function's L2 projection."""
        return self.basis(mesh).project(function)

    def evaluate(self, mesh: Mesh, x: Float, points: Float) -> Float:
        """Evaluate a discrete function at points ``(q, d)``.

        Returns values ``(q,)``, NaN outside the mesh.
        """
        return evaluate(self.basis(mesh), x, points)

    def gradient(self, mesh: Mesh, x: Float, points: Float | None = None) -> Float:
        """Evaluate the gradient ``(q, d)`` at points, NaN outside the mesh, or average it over cells."""
        return gradient(self.basis(mesh), x, points)

    def integrals(self, mesh: Mesh, x: Float) -> Float:
        """Integrate a discrete function over each cell ``(n_cells,)``."""
        return cell_integrals(self.basis(mesh), x)

    def transfer(self, mesh: Mesh, x: Float, other: Mesh, pairs: Int) -> Float:
        """Project a discrete function onto another mesh, and return its coefficients there.

        See :func:`~agglo_polydg_mg.space.projection.transfer`.
        """
        return transfer(self.basis(mesh), x, self.basis(other), pairs)

    def fluxes(self, problem: Problem, mesh: Mesh, x: Float) -> Float:
        """Return the numerical flux through each face ``(n_faces,)``, outward of the face's first cell.

        See :func:`~agglo_polydg_mg.forms.fluxes.fluxes`.
        """
        return fluxes(self.basis(mesh), mesh, x, _diffusion(problem), self.penalty)

    def residuals(self, problem: Problem, mesh: Mesh, x: Float, inside: bool = True) -> Mapping[str, Float]:
        """Return the weighted squares of all residuals of a solution, by kind and cell ``(n_cells,)``.

        See :func:`~agglo_polydg_mg.forms.residuals.squared_residuals`.
        """
        return squared_residuals(self.basis(mesh), x, _diffusion(problem), self.penalty, inside)

    def energy(self, problem: Problem, mesh: Mesh, x: Float) -> float:
        """Return ∫ ∇u·κ∇u + c u² for the function with unknowns ``x (n,)``, without jumps."""
        diffusion, basis = _diffusion(problem), self.basis(mesh)
        u = basis.coefficients(x)
        blocks = stiffness(basis, positive(basis.mesh, diffusion.kappa))
        reaction = reaction_blocks(basis, diffusion.reaction)
        blocks = blocks if reaction is None else blocks + reaction
        return float(np.einsum("ci,cij,cj->", u, blocks, u, optimize=True))

    def mass(self, mesh: Mesh) -> Any:
        """Return the mass matrix ``(n, n)``, with one block per cell."""
        return self.basis(mesh).mass()

    def quadrature(self, mesh: Mesh) -> Quadrature:
        """Return a quadrature rule on all cells, exact up to twice the degree, with the basis there."""
        return quadrature(self.basis(mesh))

    def sample(self, mesh: Mesh, x: Float) -> Samples:
        """Sample the function at points of the triangles or tetrahedra that make up the cells."""
        return samples_of(self.basis(mesh), x)

    def errors(self, problem: Problem, mesh: Mesh, x: Float) -> Mapping[str, float]:
        """Return the discretisation errors ``l2`` and ``dg``, or {} if the exact solution is unknown.

        See :class:`~agglo_polydg_mg.forms.norms.Errors`.
        """
        return self.errors_in(problem, mesh, x)

    def errors_in(
        self, problem: Problem, mesh: Mesh, x: Float, cells: Mask | None = None
    ) -> Mapping[str, float]:
        """Return the :meth:`errors` on some ``cells (n_cells,)``, with half of each face to other cells."""
        diffusion = _diffusion(problem)
        if diffusion.exact is None:
            return {}
        factor = solvers.factor_for(float(np.abs(x).max(initial=0.0)))
        diffusion = diffusion if factor == 1.0 else solvers.times(diffusion, factor)
        norms = errors(self.basis(mesh), factor * x, diffusion, penalty=self.penalty, chosen=cells)
        return {"l2": norms.l2 / factor, "dg": norms.dg / factor}

    def load(self, problem: Problem, mesh: Mesh, b: Float) -> Float:
        """Return the load ``(n,)`` of source, Neumann and Robin data: b without Dirichlet terms."""
        diffusion = _diffusion(problem)
        floats = len(boundary_faces(mesh, diffusion).floating) > 0
        return load(self.basis(mesh), diffusion) if diffusion.dirichlet or floats else b

    def residual_measure(
        self,
        problem: Problem,
        mesh: Mesh,
        b: Float,
        basis: Basis | None = None,
        earlier: EnergyNorm | None = None,
    ) -> solvers.ResidualMeasure:
        """Return the function by which solvers measure residuals, for the right-hand side ``b (n,)``.

        It weights by κ + |b| h + c h² + α h with the cell means of κ and of the reaction c, |b| at
        centroids, α of Robin data on the cell's faces, and the mean size h of all cells. The norm may reuse
        parts of an ``earlier`` norm, of a problem with an equal matrix.
        """
        diffusion, basis = _diffusion(problem), basis or self.basis(mesh)
        kappa = cell_means(mesh, diffusion.kappa)
        h = mesh.cell_measures.mean() ** (1 / mesh.dim)
        if not is_zero(diffusion.reaction):
            kappa = frozen_float(kappa + h**2 * cell_means(mesh, diffusion.reaction, "reaction"))
        kappa = frozen_float(kappa + h * mean_speed(mesh, diffusion.convection))
        if diffusion.robin:
            kappa = frozen_float(kappa + h * largest_alpha(mesh, diffusion))
        has_data = diffusion.dirichlet or diffusion.robin
        norm = EnergyNorm(basis, diffusion, self.penalty) if has_data else None
        norm = norm and earlier.with_data(diffusion) if earlier is not None else norm
        if kappa.min() == kappa.max():
            return solvers.ResidualMeasure(b, norm=norm)
        source = load(basis, diffusion) if diffusion.dirichlet else None
        return solvers.ResidualMeasure(b, np.repeat(kappa, basis.n_local), source, norm)


def _finite(values: Float) -> bool:
    """Return True if all values are finite.

    The sum of squares is tested first: it is fast, and if it is finite all values are.
    """
    flat = values.ravel()
    with np.errstate(over="ignore"):  # a square may overflow although no entry does
        return bool(np.isfinite(flat @ flat) or np.isfinite(flat).all())


def _diffusion(problem: Problem) -> Diffusion:
    if not isinstance(problem, Diffusion):
        raise OptionError(f"PolyDG discretises problems of kind diffusion; given {type(problem).__name__}")
    return problem
