"""Discretisation by conforming virtual elements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from agglo_core.authoring import (
    Diffusion,
    Field,
    Float,
    Int,
    Mask,
    Mesh,
    OptionError,
    Problem,
    Samples,
    System,
    fields,
    frozen_float,
    frozen_int,
    solvers,
)
from agglo_vem import forms
from agglo_vem.local_spaces import Space
from agglo_vem.monomials import derivatives, monomials
from agglo_vem.transfer import prolongation

_STEP: Final = 1e-3
"""Step of fourth-order differences of the exact solution, relative to |E|^(1/d): exact to about 1e-12."""


@dataclass(frozen=True)
class VirtualElements:
    """Discretise diffusion problems by conforming virtual elements on polygons and polyhedra.

    Implements :class:`~agglo_core.problems.Discretisation`. Cells may have any shape, hanging vertices and
    holes. The methods that interpret unknowns use the L2 projections of the functions on the cells.

    Attributes
    ----------
    degree : int
        Polynomial degree, 1..3; in 3-D 1.
    stabilisation : "dofi" or "d-recipe"
        See :func:`~agglo_vem.forms.stiffness`.

    Raises
    ------
    OptionError
        For any other value.
    """

    accepts: ClassVar[tuple[str, ...]] = (Diffusion.kind,)

    degree: int = 1
    stabilisation: str = "dofi"

    def __post_init__(self) -> None:
        solvers.require_count("degree", self.degree, 1, 3)
        solvers.require_name("stabilisation", self.stabilisation, forms.STABILISATIONS)

    def space(self, mesh: Mesh) -> Space:
        """Return the space on a mesh."""
        return Space(mesh, self.degree)

    def check(self, problem: Problem, mesh: Mesh) -> None:
        """Raise OptionError for convection, degrees above 1 in 3-D, and data that determine no solution.

        Likewise if the exact solution contradicts the Dirichlet data.
        """
        self._terms(problem, mesh)

    def _terms(self, problem: Problem, mesh: Mesh) -> forms.BoundaryTerms:
        if not isinstance(problem, Diffusion):
            raise OptionError(
                f"virtual elements discretise problems of kind diffusion; given {type(problem).__name__}"
            )
        if solvers.has_convection(problem):
            raise OptionError("virtual elements do not discretise convection: use the discretisation polydg")
        terms = forms.BoundaryTerms(self.space(mesh), problem)
        terms.require_consistent()
        free = np.flatnonzero(~terms.held())
        if len(free):
            raise OptionError(
                f"the component of cell {free[0]} has neither Dirichlet data nor reaction nor Robin data "
                "with positive alpha, so its solution is determined only up to a constant: use the "
                "discretisation polydg, or give a Dirichlet value"
            )
        return terms

    def assemble(self, problem: Problem, mesh: Mesh) -> System:
        """Assemble matrix and right-hand side. Unknowns belong to vertices, edges and cells, in this order.

        Rows of Dirichlet unknowns have the diagonal entry alone.
        """
        terms = self._terms(problem, mesh)
        A, b = forms.system(terms, self.stabilisation)
        if not (np.isfinite(b).all() and np.isfinite(A.data).all()):
            raise OptionError("the matrix or the right-hand side contains values that are not finite")
        return System(A, b)

    def inner_unknowns(self, mesh: Mesh) -> Int:
        """Return the unknowns inside each cell ``(n_cells, m)``."""
        return self.space(mesh).inner(np.arange(mesh.n_cells))

    def fixed_unknowns(self, problem: Problem, mesh: Mesh) -> Int:
        """Return the unknowns ``(m,)`` on Dirichlet faces."""
        return frozen_int(self._terms(problem, mesh).fixed.unknowns)

    def coarse_operator(self, problem: Problem, mesh: Mesh, labels: Int) -> Any:
        """Discretise on the agglomerates, with the means of the coefficients there."""
        assert isinstance(problem, Diffusion)
        space = self.space(mesh)
        weights = np.bincount(labels, mesh.cell_measures)

        def mean(values: Float) -> Float:
            sums = np.zeros((len(weights), *values.shape[1:]))
            np.add.at(sums, labels, values * mesh.cell_measures.reshape(-1, *(1,) * (values.ndim - 1)))
            return frozen_float(sums / weights.reshape(-1, *(1,) * (values.ndim - 1)))

        kappa = space.frames.tensor_means(fields.positive(mesh, problem.kappa), 0)[..., 0]
        reaction = fields.nonnegative(mesh, problem.reaction)
        coarse = Diffusion(
            mean(kappa),
            0.0,
            dict.fromkeys(problem.dirichlet, 0.0),
            dict.fromkeys(problem.neumann, 0.0),
            boundary=problem.boundary,
            reaction=mean(space.frames.weighted_means(reaction, 0, "reaction")[:, 0]),
            robin={
                tag: (alpha if callable(alpha) else mean(fields.per_cell(alpha, mesh.n_cells, "alpha")), 0.0)
                for tag, (alpha, _) in problem.robin.items()
            },
        )
        return self.assemble(coarse, mesh.coarsen(labels)).A

    def prolongation(self, mesh: Mesh, labels: Int) -> Any:
        """Return the matrix from the unknowns on agglomerates to those on the cells.

        See :func:`~agglo_vem.transfer.prolongation`.
        """
        return prolongation(mesh, labels, self.degree)

    def project(self, mesh: Mesh, function: Field) -> Float:
        """Return the unknowns ``(n,)`` of a function's L2 projection.

        The products are those of the L2 projections on the cells and of the mass matrix.
        """
        space = self.space(mesh)
        return frozen_float(splu(sparse.csc_array(forms.mass(space))).solve(forms.load(space, function)))

    def mass(self, mesh: Mesh) -> Any:
        """Return the mass matrix ``(n, n)``."""
        return forms.mass(self.space(mesh))

    def evaluate(self, mesh: Mesh, x: Float, points: Float) -> Float:
        """Evaluate the L2 projections on the cells at points: values ``(q,)``, NaN outside the mesh."""
        cells = fields.locate(mesh, points)
        inside, space = np.flatnonzero(cells >= 0), self.space(mesh)
        values = np.full(len(points), np.nan)
        values[inside] = _values(space, forms.polynomials(space, x), cells[inside], points[inside])
        return values

    def gradient(self, mesh: Mesh, x: Float, points: Float | None = None) -> Float:
        """Evaluate the gradients of the L2 projections at points ``(q, d)``, or average them over cells.

        They are NaN outside the mesh.
        """
        space = self.space(mesh)
        coefficients = forms.polynomials(space, x)
        if points is None:
            means = space.frames.means(self.degree - 1)
            return _gradients(space, coefficients, np.arange(mesh.n_cells), means)
        cells = fields.locate(mesh, points)
        inside = np.flatnonzero(cells >= 0)
        slopes = np.full(np.shape(points), np.nan)
        slopes[inside] = _slopes(space, coefficients, cells[inside], points[inside])
        return slopes

    def integrals(self, mesh: Mesh, x: Float) -> Float:
        """Integrate a function over each cell ``(n_cells,)``."""
        space = self.space(mesh)
        means = np.einsum("cm,cm->c", space.frames.means(self.degree), forms.polynomials(space, x))
        return frozen_float(means * mesh.cell_measures)

    def sample(self, mesh: Mesh, x: Float) -> Samples:
        """Sample the L2 projections at points of the triangles or tetrahedra that make up the cells."""
        space = self.space(mesh)
        cells, points, simplices = fields.sample_points(mesh, self.degree)
        coefficients = forms.polynomials(space, x)
        centres = points[simplices].mean(axis=1)
        slopes = _slopes(space, coefficients, cells[simplices[:, 0]], centres)
        return Samples(cells, points, simplices, _values(space, coefficients, cells, points), slopes)

    def errors(self, problem: Problem, mesh: Mesh, x: Float) -> Mapping[str, float]:
        """Return the errors ``l2`` and ``h1`` (of the gradient) of the L2 projections on the cells."""
        return self.errors_in(problem, mesh, x, np.ones(mesh.n_cells, bool))

    def errors_in(self, problem: Problem, mesh: Mesh, x: Float, cells: Mask) -> Mapping[str, float]:
        """Return the :meth:`errors` on some ``cells (n_cells,)``."""
        exact = getattr(problem, "exact", None)
        if exact is None:
            return {}
        space = self.space(mesh)
        coefficients, sums = forms.polynomials(space, x), np.zeros(2)
        sizes = _STEP * mesh.cell_measures ** (1.0 / mesh.dim)
        for batch in fields.inside(mesh, 2 * self.degree + 6):
            own, points = batch.cells, batch.points + mesh.origin
            gaps = fields.sample(exact, points, "exact") - _values(space, coefficients, own, points)
            slopes = _slopes(space, coefficients, own, points)
            for axis, step in enumerate(np.eye(mesh.dim)):
                shift = sizes[own, None] * step
                near, far = (
                    fields.sample(exact, points + j * shift, "exact")
                    - fields.sample(exact, points - j * shift, "exact")
                    for j in (1, 2)
                )
                slopes[:, axis] -= (8.0 * near - far) / (12.0 * sizes[own])
            weights = batch.weights * cells[own]
            sums += weights @ gaps**2, weights @ (slopes**2).sum(axis=1)
        return dict(zip(("l2", "h1"), np.sqrt(sums).tolist(), strict=True))

    def load(self, problem: Problem, mesh: Mesh, b: Float) -> Float:
        """Return the load ``(n,)`` of source, Neumann and Robin data: b without Dirichlet terms."""
        terms = self._terms(problem, mesh)
        load = forms.natural_load(terms)
        load[terms.fixed.unknowns] = 0.0
        return load

    def residual_measure(self, problem: Problem, mesh: Mesh, b: Float) -> Callable[[Float], float]:
        """Return the size of residuals relative to ``b (n,)``, divided by the largest κ at each unknown."""
        assert isinstance(problem, Diffusion)
        space = self.space(mesh)
        kappa = forms.mean_kappa(space, problem.kappa)
        if kappa.min() == kappa.max():
            return solvers.ResidualMeasure(b)
        return solvers.ResidualMeasure(b, frozen_float(forms.per_unknown(space, kappa)))


def _values(space: Space, coefficients: Float, cells: Int, points: Float) -> Float:
    """Evaluate polynomials with ``coefficients (n_cells, m)`` at points in known cells."""
    local = space.frames.coordinates(cells, points - space.mesh.origin)
    return np.asarray(np.einsum("qm,qm->q", monomials(local, space.degree), coefficients[cells]))


def _slopes(space: Space, coefficients: Float, cells: Int, points: Float) -> Float:
    """Evaluate the gradients ``(q, d)`` of polynomials at points in known cells."""
    local = space.frames.coordinates(cells, points - space.mesh.origin)
    return _gradients(space, coefficients, cells, monomials(local, space.degree - 1))


def _gradients(space: Space, coefficients: Float, cells: Int, values: Float) -> Float:
    """Return gradients ``(q, d)`` in known cells, from ``values (q, n)`` of the monomials to degree k − 1."""
    lower = np.einsum("cm,amn->can", coefficients, derivatives(space.degree, space.mesh.dim))
    slopes = np.einsum("qn,qan->qa", values, lower[cells])
    return np.asarray(np.einsum("qa,qab->qb", slopes, space.frames.maps[cells]))
