"""Protocols of problems, and of discretisations, which turn problems into linear systems."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

from agglo_core.arrays import Float, Int
from agglo_core.mesh import Mesh
from agglo_core.mesh.elsewhere import made_by
from agglo_core.problems.system import System

Field = float | Float | Callable[[Float], Float]
"""A number, one value per cell ``(n,)``, or a callable of points ``(q, d)`` returning ``(q,)``."""


@runtime_checkable
class Problem(Protocol):
    """Anything a solver may be asked to solve: a record that names its kind.

    ``kind`` is the name under which the class is declared as a component of the kind ``problem``; a solver
    lists those it takes in ``accepts``. Optional is ``posed_on(mesh)``, which returns the problem as it is
    on a mesh: called by :func:`~agglo_core.problems.named_problem`.

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
    """A function at points of each cell, and the simplices between them, for files and pictures.

    No two cells share points, so that jumps stay visible.

    Attributes
    ----------
    cells : (q,) int
        Cell of each point.
    points : (q, d) float
    simplices : (t, d + 1) int
        Triangles or tetrahedra, each within one cell, by their points.
    values : (q,) float
    """

    cells: Int
    points: Float
    simplices: Int
    values: Float

    def plot(self, ax: Any = None, *, across: str = "z", cmap: str = "viridis") -> Any:
        """Draw the function on axes of matplotlib, with its jumps; in 3-D on a plane through the middle.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            By default those of a new figure of pyplot, which notebooks and ``plt.show()`` show.
        across : {"x", "y", "z"}
            In 3-D: the axis that the plane is perpendicular to.
        cmap : str
            Colour map of matplotlib.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        OptionError
            Without matplotlib, or for an argument that is not as above.

        Examples
        --------
        >>> import numpy as np
        >>> corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        >>> ax = Samples(np.zeros(3, int), corners, np.array([[0, 1, 2]]), corners[:, 0]).plot()
        >>> ax.get_xlabel(), ax.get_ylabel()
        ('x', 'y')
        """
        return made_by("agglo_core.draw.on_axes:plot_samples")(self, ax, across=across, cmap=cmap)


@runtime_checkable
class Discretisation(Protocol):
    """How problems become linear systems on a mesh, and what their unknowns mean.

    A solver that has one as its attribute ``discretisation`` gets files, pictures and error norms of
    ``agglo solve``. ``accepts`` lists the kinds of problem it discretises; what the
    unknowns of other problems, such as a linear system, mean is known only to their author.

    Optional is ``errors_in(problem, mesh, x, cells)``: norms as of ``errors``, over the cells that the mask
    ``cells (n_cells,)`` chooses, and half of their faces to others. Over a division of the mesh the squares
    add up to those of ``errors``. On several ranks each measures its own cells so.

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
        """Quick check: raise an AggloError if it cannot discretise the problem on the mesh."""
        ...

    def assemble(self, problem: Problem, mesh: Mesh) -> System:
        """Return matrix and right-hand side of the problem on the mesh."""
        ...

    def coarse_operator(self, problem: Problem, mesh: Mesh, labels: Int) -> Any:
        """Return the matrix of the problem on the agglomerates ``labels (n_cells,)`` of the mesh.

        It is for corrections: the boundary conditions are the same, with data 0.
        """
        ...

    def project(self, mesh: Mesh, function: Field) -> Float:
        """Return the unknowns ``(n,)`` of the L2 projection of a function."""
        ...

    def evaluate(self, mesh: Mesh, x: Float, points: Float) -> Float:
        """Return the values ``(q,)`` of the function with unknowns ``x (n,)`` at points; NaN outside."""
        ...

    def sample(self, mesh: Mesh, x: Float) -> Samples:
        """Return the function with unknowns ``x (n,)`` at points of each cell."""
        ...

    def errors(self, problem: Problem, mesh: Mesh, x: Float) -> Mapping[str, float]:
        """Return norms of the error by name (``"l2"``, …), none if the exact solution is not known."""
        ...

    def load(self, problem: Problem, mesh: Mesh, b: Float) -> Float:
        """Return the right-hand side ``b (n,)`` of the problem without what Dirichlet data put there.

        Its product with x is the work of source and fluxes.
        """
        ...

    def residual_measure(self, problem: Problem, mesh: Mesh, b: Float) -> Callable[[Float], float]:
        """Return a function that measures residuals ``(n,)`` relative to the right-hand side ``b (n,)``."""
        ...
