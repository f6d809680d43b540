"""Protocols for problems, and for discretisations, which map problems to linear systems."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.mesh import Mesh
from agglo_core.mesh.elsewhere import import_function
from agglo_core.problems.system import System

Field = float | Float | Callable[[Float], Float]
"""A number, one value per cell ``(n,)``, or a function of points ``(q, d)`` with values ``(q,)``."""


@runtime_checkable
class Problem(Protocol):
    """Problem to be solved, with the name of its kind, such as diffusion.

    ``kind`` is the component name of the class (component kind ``problem``). A solver lists the accepted
    kinds in ``accepts``. The optional method ``posed_on(mesh)`` returns the problem as posed on a mesh, and
    is called by :func:`~agglo_core.problems.named_problem`.

    Examples
    --------
    >>> from agglo_core.problems import Problem
    >>> problem: Problem = agglo.Diffusion(source=2.0)
    >>> problem.kind
    'diffusion'
    """

    kind: ClassVar[str]


@dataclass(frozen=True, eq=False)
class Samples:
    """Function values at points in each cell, with simplices between the points, for files and plots.

    Cells do not share points, so that jumps remain visible.

    Attributes
    ----------
    cells : (q,) int
        Cell per point.
    points : (q, d) float
    simplices : (t, d + 1) int
        Triangles or tetrahedra by point numbers, each within one cell. Polyhedra that are not star-shaped
        may have none: files contain them as polyhedra, and they cannot be drawn.
    values : (q,) or (q, d) float
        Numbers, or vectors such as displacements.
    gradients : (t, d) or (t, d, d) float, optional
        Gradient at the centroid of each simplex, for vectors ∂u_i/∂x_j; written to files.
    stresses : (t, 3, 3) float, optional
        Stress at the centroid of each simplex, written to files.
    """

    cells: Int
    points: Float
    simplices: Int
    values: Float
    gradients: Float | None = None
    stresses: Float | None = None

    @property
    def sizes(self) -> Float:
        """The values, or the lengths of vectors ``(q,)``: what pictures show."""
        return self.values if self.values.ndim == 1 else np.linalg.norm(self.values, axis=1)

    def plot(self, ax: Any = None, *, across: str = "z", cmap: str = "viridis") -> Any:
        """Draw the function with its jumps on matplotlib axes, in 3-D on a plane through the middle.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Default: axes of a new pyplot figure, shown by notebooks and ``plt.show()``.
        across : {"x", "y", "z"}
            Axis perpendicular to the plane in 3-D.
        cmap : str
            Matplotlib colour map.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        OptionError
            Without matplotlib, or for an invalid argument.

        Examples
        --------
        >>> import numpy as np
        >>> corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        >>> ax = Samples(np.zeros(3, int), corners, np.array([[0, 1, 2]]), corners[:, 0]).plot()
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('x', 'y')
        """
        return import_function("agglo_core.draw.on_axes:plot_samples")(self, ax, across=across, cmap=cmap)


class Quadrature(NamedTuple):
    """Quadrature rule on all cells of a mesh, with the basis functions at its points.

    Attributes
    ----------
    points : (q, d) float
    weights : (q,) float
        They sum to the measure of the mesh.
    values : (q, n) sparse
        Basis functions: ``values @ x`` is a function at the points, ``values.T @ (weights * f)`` the load
        of f.

    Examples
    --------
    >>> import numpy as np
    >>> polydg = agglo.registry.default().build("discretisation", "polydg", degree=1)
    >>> mesh = agglo.samples.squares(2)
    >>> points, weights, values = polydg.quadrature(mesh)
    >>> bool(np.allclose(values @ polydg.project(mesh, 3.0), 3.0)), round(float(weights.sum()), 12)
    (True, 1.0)
    """

    points: Float
    weights: Float
    values: Any


@runtime_checkable
class Discretisation(Protocol):
    """Map from problems on a mesh to linear systems, and from unknowns back to functions.

    Solvers with an attribute ``discretisation`` get the files, pictures and error norms of ``agglo solve``.
    ``accepts`` lists the kinds of problem that can be discretised. Unknowns of other problems, such as linear
    systems, cannot be interpreted.

    Optional methods:

    - ``gradient(mesh, x, points=None)``: gradients ``(q, d)`` at points, NaN outside the mesh, or means over
      the cells; ``(q, d, d)`` for vectors;
    - ``locate(mesh, points)``: cells ``(q,)`` in which ``gradient`` evaluates, −1 outside the mesh;
    - ``integrals(mesh, x)``: integrals over the cells ``(n_cells,)``, or ``(n_cells, d)`` for vectors;
    - ``fluxes(problem, mesh, x)``: flux through each face ``(n_faces,)``, outward of its first cell; the
      fluxes out of a cell sum to the integral of its source, if x solves the system;
    - ``mass(mesh)``: mass matrix M ``(n, n)``; xᵀ M y is the integral of the product of two functions;
    - ``quadrature(mesh)``: a :class:`Quadrature`, for nonlinear terms;
    - ``errors_in(problem, mesh, x, cells)``: norms as ``errors``, restricted to the cells in the mask
      ``cells (n_cells,)`` and to half of their faces to other cells. Over a partition of the mesh, the
      squares add up to those of ``errors``. On several ranks, each rank measures its own cells.
    - ``fixed_unknowns(problem, mesh)``: unknowns ``(m,)`` that Dirichlet data fix; their rows and columns of
      the matrix have the diagonal entry alone. Solvers subtract their values, and add no load to them.
    - ``inner_unknowns(mesh)``: unknowns ``(n_cells, m)`` inside each cell, which solvers eliminate;
    - ``means(problem, mesh)``: a map from unknowns to those of the mean, constant on components where the
      solution is determined only up to a constant and 0 elsewhere, or None. Solvers subtract the mean.
    - ``energy(problem, mesh, x)``: the square of the energy norm of the function, without jumps;
    - ``residuals(problem, mesh, x, inside=True)``: squares by name and cell ``(n_cells,)``, whose sum
      estimates the square of the error in the energy norm: ``cell``, and others on faces. ``oscillation`` is
      the share of ``cell`` that the discretisation cannot represent. With ``inside=False`` both are omitted.
      :func:`agglo_core.adapt` refines by them.
    - ``transfer(mesh, x, other, pairs)``: unknowns on the mesh ``other`` of the projection of the function
      with unknowns x; ``pairs (k, 2)`` are the overlapping cells of both meshes, of which one contains the
      other. :func:`agglo_core.adapt` starts each solve from it.
    - ``of_kind(kind)``: the discretisation for another kind of problem, with equal options. A solver then
      needs a single ``discretisation`` for all kinds that it accepts.

    Examples
    --------
    >>> polydg = agglo.registry.default().build("discretisation", "polydg", degree=1)
    >>> mesh = agglo.samples.squares(2)
    >>> system = polydg.assemble(agglo.Diffusion(), mesh)
    >>> system.n, polydg.evaluate(mesh, polydg.project(mesh, 3.0), mesh.cell_centroids[:1]).round(12)
    (12, array([3.]))
    """

    accepts: tuple[str, ...]

    def check(self, problem: Problem, mesh: Mesh) -> None:
        """Raise an AggloError if the problem cannot be discretised on the mesh (a quick check)."""
        ...

    def assemble(self, problem: Problem, mesh: Mesh) -> System:
        """Return matrix and right-hand side for the problem on the mesh."""
        ...

    def coarse_operator(self, problem: Problem, mesh: Mesh, labels: Int) -> Any:
        """Return the matrix for the problem on the agglomerates ``labels (n_cells,)``.

        The matrix is used for corrections: boundary conditions are kept, with data 0.
        """
        ...

    def project(self, mesh: Mesh, function: Field) -> Float:
        """Return the unknowns ``(n,)`` of a function's L2 projection.

        If values are vectors, a function with values ``(q,)`` stands for equal components.
        """
        ...

    def evaluate(self, mesh: Mesh, x: Float, points: Float) -> Float:
        """Evaluate the function with unknowns ``x (n,)`` at points: values ``(q,)``, NaN outside the mesh.

        Vector functions have values ``(q, d)``.
        """
        ...

    def sample(self, mesh: Mesh, x: Float) -> Samples:
        """Return the values of the function with unknowns ``x (n,)`` at points in each cell."""
        ...

    def errors(self, problem: Problem, mesh: Mesh, x: Float) -> Mapping[str, float]:
        """Return norms of the error by name, or none without an exact solution.

        ``l2``, ``h1`` and the energy norm: ``dg`` with jumps, or ``energy``.
        """
        ...

    def load(self, problem: Problem, mesh: Mesh, b: Float) -> Float:
        """Return the right-hand side ``b (n,)`` without Dirichlet terms.

        Its product with x is the work of source and fluxes.
        """
        ...

    def residual_measure(self, problem: Problem, mesh: Mesh, b: Float) -> Callable[[Float], float]:
        """Return a function that measures residuals ``(n,)`` relative to the right-hand side ``b (n,)``."""
        ...
