"""Discretisation by conforming virtual elements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

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
from agglo_vem.projections import project
from agglo_vem.residuals import squared_residuals
from agglo_vem.transfer import prolongation


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
        See :meth:`~agglo_vem.forms.LocalForms.stiffness`.

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
        """Raise OptionError for convection, degrees above 1 in 3-D, or contradictory data."""
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
        return frozen_int(self._terms(problem, mesh).fixed[0])

    def means(self, problem: Problem, mesh: Mesh) -> Callable[[Float], Float] | None:
        """Return a map from unknowns to those of the mean on floating components, None without any."""
        floating = self._terms(problem, mesh).floating
        return None if floating is None else floating.means

    def coarse_operator(self, problem: Problem, mesh: Mesh, labels: Int) -> Any:
        """Discretise on the agglomerates, with the means of the coefficients there."""
        assert isinstance(problem, Diffusion)
        return self.assemble(fields.corrections(problem, mesh, labels), mesh.coarsen(labels)).A

    def prolongation(self, mesh: Mesh, labels: Int) -> Any:
        """Return the injection from agglomerates, :func:`~agglo_vem.transfer.prolongation`."""
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
        inside, at = self._inside(mesh, x, points)
        values = np.full(len(points), np.nan)
        values[inside] = at.values
        return values

    def gradient(self, mesh: Mesh, x: Float, points: Float | None = None) -> Float:
        """Evaluate the gradients of the L2 projections at points ``(q, d)``, or average them over cells.

        They are NaN outside the mesh.
        """
        if points is None:
            space = self.space(mesh)
            means, slopes = space.frames.means(self.degree), project(space, x).slopes
            return frozen_float(np.einsum("cm,cdm->cd", means, slopes))
        inside, at = self._inside(mesh, x, points)
        slopes = np.full(np.shape(points), np.nan)
        slopes[inside] = at.slopes
        return slopes

    def _inside(self, mesh: Mesh, x: Float, points: Float) -> tuple[Int, fields.AtPoints]:
        cells = fields.locate(mesh, points)
        inside = np.flatnonzero(cells >= 0)
        return inside, project(self.space(mesh), x).at(cells[inside], points[inside] - mesh.origin)

    def integrals(self, mesh: Mesh, x: Float) -> Float:
        """Integrate a function over each cell ``(n_cells,)``."""
        space = self.space(mesh)
        means = (space.frames.means(self.degree) * project(space, x).coefficients).sum(axis=1)
        return frozen_float(means * mesh.cell_measures)

    def sample(self, mesh: Mesh, x: Float) -> Samples:
        """Sample the L2 projections at points of the triangles or tetrahedra that make up the cells."""
        cells, points, simplices = fields.sample_points(mesh, self.degree)
        function, centres = project(self.space(mesh), x), points[simplices].mean(axis=1) - mesh.origin
        slopes = function.at(cells[simplices[:, 0]], centres).slopes
        return Samples(cells, points, simplices, function.at(cells, points - mesh.origin).values, slopes)

    def errors(self, problem: Problem, mesh: Mesh, x: Float) -> Mapping[str, float]:
        """Return the errors of the L2 projections on the cells.

        ``l2``, ``h1`` = ‖∇e‖, and ``energy`` = ‖√κ ∇e‖.
        """
        return self.errors_in(problem, mesh, x, np.ones(mesh.n_cells, bool))

    def errors_in(self, problem: Problem, mesh: Mesh, x: Float, cells: Mask) -> Mapping[str, float]:
        """Return the :meth:`errors` on some ``cells (n_cells,)``."""
        assert isinstance(problem, Diffusion)
        return fields.error_norms(mesh, problem, self.degree, project(self.space(mesh), x), cells)

    def energy(self, problem: Problem, mesh: Mesh, x: Float) -> float:
        """Return the square of the energy norm: that of the projections, and the stabilisation."""
        assert isinstance(problem, Diffusion)
        return float(x @ (forms.LocalForms(self.space(mesh), problem, self.stabilisation).matrix() @ x))

    def residuals(self, problem: Problem, mesh: Mesh, x: Float, inside: bool = True) -> Mapping[str, Float]:
        """Return the weighted squares of all residuals of a solution, by kind and cell ``(n_cells,)``.

        See :func:`~agglo_vem.residuals.squared_residuals`.
        """
        return squared_residuals(self._terms(problem, mesh), x, self.stabilisation, inside)

    def load(self, problem: Problem, mesh: Mesh, b: Float) -> Float:
        """Return the load ``(n,)`` of source, Neumann and Robin data: b without Dirichlet terms."""
        terms = self._terms(problem, mesh)
        load = terms.load()
        load[terms.fixed[0]] = 0.0
        return load

    def residual_measure(self, problem: Problem, mesh: Mesh, b: Float) -> Callable[[Float], float]:
        """Return the size of residuals relative to ``b (n,)``, divided by the largest κ at each unknown."""
        assert isinstance(problem, Diffusion)
        space, largest = self.space(mesh), np.zeros(len(b))
        kappa = forms.LocalForms(space, problem, self.stabilisation).mean_kappa
        for batch in space.batches():
            np.maximum.at(largest, batch.unknowns, kappa[batch.cells][:, None])
        return solvers.ResidualMeasure(b, frozen_float(largest))
