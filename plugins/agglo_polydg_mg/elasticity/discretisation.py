"""Discretisation of elasticity: matrices, loads, sample values and error norms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from agglo_core.authoring import (
    Elasticity,
    Field,
    Float,
    Int,
    Mask,
    Mesh,
    OptionError,
    Problem,
    Samples,
    System,
    VectorField,
    fields,
    frozen_float,
    frozen_int,
    solvers,
)
from agglo_polydg_mg.elasticity.face_forces import face_forces
from agglo_polydg_mg.elasticity.forms import matrix
from agglo_polydg_mg.elasticity.loads import (
    displacement_load,
    elastic_boundary,
    external_load,
    require_consistent,
)
from agglo_polydg_mg.elasticity.material import Material
from agglo_polydg_mg.elasticity.norms import ElasticNorm, elastic_errors
from agglo_polydg_mg.elasticity.penalty import elastic_penalty
from agglo_polydg_mg.elasticity.vectors import (
    components,
    joined,
    rigid_motions,
    split,
    vector_blocks,
)
from agglo_polydg_mg.forms.sides import with_straight_sides
from agglo_polydg_mg.space.basis import Basis, block_diagonal
from agglo_polydg_mg.space.sampling import cell_integrals, evaluate, gradient, samples_of


class Assembled(NamedTuple):
    """System of an elasticity problem with the data that it was assembled from."""

    system: System
    basis: Basis
    material: Material
    sigma: Float


@dataclass(frozen=True)
class PolyDGElasticity:
    """Discretise linear elasticity by a discontinuous Galerkin method on polygons and polyhedra.

    Implements :class:`~agglo_core.problems.Discretisation`. The displacement has ``degree`` in each
    component; the jump penalty is
    :func:`~agglo_polydg_mg.elasticity.penalty.elastic_penalty`. Unknowns are ordered by cell, in a cell by
    component.

    Attributes
    ----------
    degree : int
        Polynomial degree, 1..6.

    Raises
    ------
    OptionError
        For any other degree.
    """

    accepts: ClassVar[tuple[str, ...]] = (Elasticity.kind,)

    degree: int = 1

    def __post_init__(self) -> None:
        solvers.require_count("degree", self.degree, 1, 6)

    def basis(self, mesh: Mesh) -> Basis:
        """Return the basis of each component, in 2-D on the mesh with collinear edges merged."""
        return Basis(with_straight_sides(mesh), self.degree, scaled=True)

    def check(self, problem: Problem, mesh: Mesh) -> None:
        """Raise OptionError if the data do not fit the mesh or the exact solution."""
        elasticity = _elasticity(problem)
        elasticity.lame(mesh.n_cells)
        require_consistent(self.basis(mesh), elasticity)

    def assemble(self, problem: Problem, mesh: Mesh) -> System:
        """Assemble matrix, right-hand side and rigid motions of a problem on a mesh.

        Raises
        ------
        OptionError
            For an impossible material, data with nonfinite values or the wrong shape, tags missing on the
            boundary, or a domain component that can move rigidly.
        MeshError
            For degenerate cells.
        """
        return replace_mesh(self.assembled(problem, mesh).system, mesh)

    def assembled(self, problem: Problem, mesh: Mesh, basis: Basis | None = None) -> Assembled:
        """Assemble a problem, and return the system with its penalty and material."""
        # 1. Data, penalty and matrix
        elasticity, basis = _elasticity(problem), basis or self.basis(mesh)
        material = Material(*elasticity.lame(mesh.n_cells))
        require_consistent(basis, elasticity)
        boundary = elastic_boundary(basis.mesh, elasticity)
        sigma = self._penalty(basis, material, elasticity)
        reaction = elasticity.reactions(mesh.n_cells)
        A = matrix(basis, material, reaction, sigma)
        # 2. Loads
        load = external_load(basis, elasticity, boundary)
        load += displacement_load(basis, material, boundary, elasticity.displacement, sigma)
        b, width = frozen_float(load.ravel()), mesh.dim * basis.n_local
        offsets = frozen_int(np.arange(mesh.n_cells + 1) * width)
        system = System.trusted(A, b, offsets, basis.mesh, rigid_motions(basis))
        return Assembled(system, basis, material, sigma)

    def _penalty(self, basis: Basis, material: Material, problem: Elasticity) -> Float:
        penalised = np.ones(basis.mesh.n_faces, bool)
        penalised[elastic_boundary(basis.mesh, problem).natural] = False
        return elastic_penalty(basis, material, penalised)

    def fine_system(self, problem: Problem, mesh: Mesh) -> solvers.FineSystem:
        """Return the system on a mesh in the form that solvers require.

        Raises
        ------
        OptionError
            As :meth:`assemble`; also for values that are not finite.
        """
        return self.fine_from(self.assembled(problem, mesh), problem, mesh)

    def fine_from(self, assembled: Assembled, problem: Problem, mesh: Mesh) -> solvers.FineSystem:
        """Return an assembled system in the form that solvers require, scaled by powers of two."""
        A, b = assembled.system.A, assembled.system.b
        if not (np.isfinite(b).all() and np.isfinite(A.data).all()):
            raise OptionError("the matrix or the right-hand side contains values that are not finite")
        factor, of_matrix = solvers.factor_for(float(np.abs(b).max(initial=0.0))), solvers.matrix_factor(A)
        scaled = frozen_float(factor * b)
        measure = self._measure(assembled, _elasticity(problem), scaled, factor, of_matrix)
        return solvers.FineSystem(
            A if of_matrix == 1.0 else A * of_matrix,
            scaled,
            mesh.dim * assembled.basis.n_local,
            measure,
            full=scaled,
            factor=factor,
            sigma=assembled.sigma,
            meaning=(self, mesh, problem),
            matrix_factor=of_matrix,
        )

    def matrix_kind(self, problem: Problem, fine: solvers.FineSystem) -> str:
        """Return the kind of matrix, by which solvers recommend multigrid or a direct method."""
        return "linear"

    def coarse_operator(self, problem: Problem, mesh: Mesh, labels: Int) -> Any:
        """Rediscretise on agglomerates, with the means of the coefficients, for corrections."""
        elasticity = _elasticity(problem)
        measures = np.bincount(labels, mesh.cell_measures)
        lame, mu, reaction = (
            np.bincount(labels, mesh.cell_measures * each) / measures
            for each in (*elasticity.lame(mesh.n_cells), elasticity.reactions(mesh.n_cells))
        )
        zero = (0.0,) * mesh.dim
        coarse = Elasticity(
            displacement=dict.fromkeys(elasticity.displacement, zero),
            traction=dict.fromkeys(elasticity.traction, zero),
            boundary=elasticity.boundary,
            lame_lambda=lame,
            lame_mu=mu,
            reaction=reaction,
        )
        return self.assemble(coarse, mesh.coarsen(labels)).A

    def project(self, mesh: Mesh, function: Field | VectorField) -> Float:
        """Return the coefficients ``(n,)`` of the L2 projection of a vector field.

        A number, or a callable with values ``(q,)``, stands for equal components.
        """
        basis, dim = self.basis(mesh), mesh.dim
        if not callable(function):
            field: VectorField = (float(function),) * dim if np.ndim(function) == 0 else function  # type: ignore[arg-type, assignment]
        else:

            def field(points: Float) -> Float:
                values = np.asarray(function(points), float)
                return np.repeat(values[:, None], dim, axis=1) if values.ndim == 1 else values

        return joined(basis, [basis.project(each) for each in components(field, mesh, "the function")])

    def evaluate(self, mesh: Mesh, x: Float, points: Float) -> Float:
        """Evaluate a displacement at points ``(q, d)``: values ``(q, d)``, NaN outside the mesh."""
        basis = self.basis(mesh)
        return evaluate(basis, split(basis, x), points)

    def gradient(self, mesh: Mesh, x: Float, points: Float | None = None) -> Float:
        """Evaluate the gradient ∂u_i/∂x_j ``(q, d, d)`` at points, or average it over cells."""
        basis = self.basis(mesh)
        return gradient(basis, split(basis, x), points)

    def locate(self, mesh: Mesh, points: Float) -> Int:
        """Find the cell ``(q,)`` of each point, as :meth:`evaluate` does, −1 outside the mesh."""
        return fields.locate(mesh, points)

    def integrals(self, mesh: Mesh, x: Float) -> Float:
        """Integrate the displacement over each cell: ``(n_cells, d)``."""
        basis = self.basis(mesh)
        return cell_integrals(basis, split(basis, x))

    def fluxes(self, problem: Problem, mesh: Mesh, x: Float) -> Float:
        """Return the force on the first cell of each face ``(n_faces, d)``.

        See :func:`~agglo_polydg_mg.elasticity.face_forces.face_forces`.
        """
        elasticity, basis = _elasticity(problem), self.basis(mesh)
        material = Material(*elasticity.lame(mesh.n_cells))
        sigma = self._penalty(basis, material, elasticity)
        return face_forces(basis, mesh, x, elasticity, material, sigma)

    def mass(self, mesh: Mesh) -> Any:
        """Return the mass matrix ``(n, n)``, with one block per cell."""
        blocks = self.basis(mesh).mass_blocks
        return block_diagonal(vector_blocks(blocks, mesh.dim))

    def sample(self, mesh: Mesh, x: Float) -> Samples:
        """Sample the displacement, with values ``(q, d)``, at points in each cell."""
        basis = self.basis(mesh)
        return samples_of(basis, split(basis, x))

    def errors(self, problem: Problem, mesh: Mesh, x: Float) -> Mapping[str, float]:
        """Return the errors ``l2`` and ``energy``, or {} if the exact solution is unknown."""
        return self.errors_in(problem, mesh, x)

    def errors_in(
        self, problem: Problem, mesh: Mesh, x: Float, cells: Mask | None = None
    ) -> Mapping[str, float]:
        """Return the :meth:`errors` on some ``cells (n_cells,)``, with half of each face to other cells."""
        elasticity, basis = _elasticity(problem), self.basis(mesh)
        if elasticity.exact is None:
            return {}
        material = Material(*elasticity.lame(mesh.n_cells))
        sigma = self._penalty(basis, material, elasticity)
        l2, energy = elastic_errors(basis, x, elasticity, material, sigma, cells)
        return {"l2": l2, "energy": energy}

    def load(self, problem: Problem, mesh: Mesh, b: Float) -> Float:
        """Return the load ``(n,)`` of body force and tractions, without the terms of displacements."""
        elasticity, basis = _elasticity(problem), self.basis(mesh)
        if not elasticity.displacement:
            return b
        boundary = elastic_boundary(basis.mesh, elasticity)
        return frozen_float(external_load(basis, elasticity, boundary).ravel())

    def residual_measure(self, problem: Problem, mesh: Mesh, b: Float) -> solvers.ResidualMeasure:
        """Return the function by which solvers measure residuals, for the right-hand side ``b (n,)``."""
        assembled = self.assembled(problem, mesh)
        return self._measure(assembled, _elasticity(problem), b)

    def _measure(
        self, assembled: Assembled, problem: Elasticity, b: Float, factor: float = 1.0, of_matrix: float = 1.0
    ) -> solvers.ResidualMeasure:
        """Return the residual measure of a system times ``of_matrix``, with b times ``factor``.

        It is weighted by 2μ + λ + c h² if that varies, with the reaction c and the mean cell size h.
        """
        norm: Callable[[Float], float] | None = None
        if any(callable(each) or np.any(each) for each in problem.displacement.values()):
            _, basis, material, sigma = assembled
            energy, back = ElasticNorm(basis, problem, material, sigma), of_matrix / factor

            def norm(x: Float) -> float:
                return float(np.sqrt(of_matrix) / back * energy(back * x))

        mesh = assembled.basis.mesh
        h = mesh.cell_measures.mean() ** (1 / mesh.dim)
        stiffness = assembled.material.acoustic[:, 1] + h**2 * problem.reactions(mesh.n_cells)
        if stiffness.min() == stiffness.max():
            return solvers.ResidualMeasure(b, norm=norm)
        kappa = np.repeat(stiffness, mesh.dim * assembled.basis.n_local)
        return solvers.ResidualMeasure(b, frozen_float(kappa), norm=norm)


def replace_mesh(system: System, mesh: Mesh) -> System:
    """Return a system for the user's mesh, which may have more faces than the mesh of the basis."""
    return System.trusted(system.A, system.b, system.block_offsets, mesh, system.near_null)


def _elasticity(problem: Problem) -> Elasticity:
    if not isinstance(problem, Elasticity):
        raise OptionError(
            f"PolyDGElasticity discretises problems of kind elasticity; given {type(problem).__name__}"
        )
    return problem
