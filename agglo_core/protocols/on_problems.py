"""Protocols of problems, solvers, estimators and smoothers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, Self, runtime_checkable

from agglo_core.arrays import Float

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh
    from agglo_core.problems import MultigridLevel, Problem, Solution


@runtime_checkable
class ProblemKind(Protocol):
    """Class of immutable problem data, whose attribute ``kind`` is its declared name.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from typing import ClassVar
    >>> from agglo_core.protocols import ProblemKind
    >>> @dataclass(frozen=True)
    ... class Decay:
    ...     kind: ClassVar[str] = "decay"
    ...     rate: float = 1.0
    ...
    ...     @classmethod
    ...     def from_table(cls, table, mesh, folder):
    ...         return cls(table["rate"])
    ...
    ...     @classmethod
    ...     def example(cls, mesh):
    ...         return cls()
    >>> isinstance(Decay(), ProblemKind), Decay.from_table({"rate": 2.0}, None, None).rate
    (True, 2.0)
    """

    kind: ClassVar[str]

    @classmethod
    def from_table(cls, table: Mapping[str, Any], mesh: Mesh, folder: Path) -> Self:
        """Build the problem from a TOML table, with file names relative to ``folder``.

        An AggloError names the wrong key.
        """

    @classmethod
    def example(cls, mesh: Mesh) -> Self:
        """Return a small problem on the given mesh, with exactly one solution, for tests of solvers."""


@runtime_checkable
class Estimator(Protocol):
    """Component that estimates the error of a solution in each cell, for :func:`agglo_core.adapt`.

    ``accepts`` lists the supported problem kinds. The estimate of the whole error is the root of the sum of
    squared indicators. The optional method ``terms(solution)`` returns arrays ``(n_cells,)`` by name,
    whose squares sum to those of the indicators, except for ``oscillation``: the share due to data that the
    discretisation cannot represent, contained in the others.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.protocols import Estimator
    >>> class Steepness:
    ...     accepts = ("diffusion",)
    ...
    ...     def indicate(self, solution):
    ...         slopes = solution.gradient(solution.mesh.cell_centroids)
    ...         return solution.mesh.cell_measures * np.linalg.norm(slopes, axis=1)
    >>> isinstance(Steepness(), Estimator)
    True
    >>> solution = agglo.solve(agglo.samples.squares(4), agglo.Diffusion(source=8.0))
    >>> Steepness().indicate(solution).shape
    (16,)
    """

    accepts: tuple[str, ...]

    def indicate(self, solution: Solution) -> Float:
        """Return the estimated error ``(n_cells,)`` of a solution in each cell of its mesh, not negative."""


@runtime_checkable
class Smoother(Protocol):
    """Component that smooths the error on one multigrid level.

    A smoother that needs no coarse correction sets ``uses_coarse = False``, which saves the factorisation.

    Examples
    --------
    >>> from agglo_core.protocols import Smoother
    >>> class Jacobi:
    ...     def setup(self, level):
    ...         return lambda b, x: x + 0.5 * (b - level.A @ x) / level.A.diagonal()
    >>> isinstance(Jacobi(), Smoother)
    True
    """

    def setup(self, level: MultigridLevel) -> Callable[[Float, Float], Float]:
        """Return ``smooth(b, x)``, a function that returns an improved x ``(n,)``.

        It may also be a ``multigrid.LevelSmoother``.
        """


@runtime_checkable
class Solver(Protocol):
    """Component that solves a problem with a hierarchy of coarse meshes.

    ``accepts``, if present, lists the supported problem kinds. ``discretisation``, if present, defines the
    meaning of the unknowns (:class:`~agglo_core.problems.Discretisation`). With the promise ``symmetric`` the
    solver also has ``aspreconditioner(problem, hierarchy)``, which returns a
    ``scipy.sparse.linalg.LinearOperator``. It sets ``needs_levels = False`` if it needs no levels,
    ``plain_cg = True`` if it is plain conjugate gradients, and ``galerkin = False`` if its coarse operators
    are not Pᵀ A P but rediscretised or rounded. With ``takes_start = True`` it takes an initial guess
    ``start (n,)``, as :func:`agglo_core.adapt` gives. With ``reports_progress = True`` it takes ``progress``,
    None or for :func:`agglo_core.progress.phase`.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.sparse.linalg import spsolve
    >>> from agglo_core.problems.linear import symmetric_system
    >>> from agglo_core.protocols import Solver
    >>> class Exact:
    ...     def solve(self, problem, hierarchy):
    ...         A, b = symmetric_system(problem)
    ...         x = spsolve(A.tocsc(), b)
    ...         sizes = np.linalg.norm([b, b - A @ x], axis=1)
    ...         return agglo.Solution(x, A, b, [], sizes, True, "factorised", 1, {})
    >>> isinstance(Exact(), Solver)
    True
    >>> Exact().solve(agglo.Linear(np.diag([2.0, 4.0]), np.ones(2), np.arange(3)), None).x
    array([0.5 , 0.25])
    """

    def solve(self, problem: Problem, hierarchy: Hierarchy) -> Solution:
        """Return the solution with its convergence history."""
