"""Solutions returned by solvers, and dataclass fields computed on first use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import Any, TypeVar

import numpy as np

from agglo_core.arrays import Float, Mask, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.hierarchy.cuts import Cut
from agglo_core.mesh import Mesh
from agglo_core.mesh.elsewhere import import_function
from agglo_core.problems.discretisation import Discretisation, Problem, Samples
from agglo_core.problems.iteration_history import History, empty_array, mean_contraction
from agglo_core.problems.multigrid_level import LevelTable

_Record = TypeVar("_Record")


class Deferred:
    """Value computed by ``make`` on first access. ``make`` is then released.

    Examples
    --------
    >>> from agglo_core.problems.solution import Deferred
    >>> answer = Deferred(lambda: print("made") or 42)
    >>> answer.value, answer.value
    made
    (42, 42)
    """

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make: Callable[[], Any] | None = make

    @property
    def value(self) -> Any:
        """The value, computed on first access."""
        if self._make is not None:
            self._value, self._make = self._make(), None
        return self._value


def deferrable(*names: str) -> Callable[[type[_Record]], type[_Record]]:
    """Decorate a dataclass so that the named fields accept :class:`Deferred` values.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @deferrable("total")
    ... @dataclass(frozen=True)
    ... class Sum:
    ...     total: int
    >>> Sum(3).total, Sum(Deferred(lambda: 1 + 2)).total
    (3, 3)
    """

    def marked(record: type[_Record]) -> type[_Record]:
        for name in names:
            setattr(record, name, _Field(name))
        return record

    return marked


class _Field:
    """Descriptor of a dataclass field whose deferred value is computed on access."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            raise AttributeError(self._name)  # like other fields, not a class attribute
        fields = vars(instance)
        if isinstance(fields[self._name], Deferred):
            fields[self._name] = fields[self._name].value
        return fields[self._name]

    def __set__(self, instance: Any, value: Any) -> None:
        vars(instance)[self._name] = value


@dataclass(frozen=True, eq=False)
class Lifting:
    """Shifted system solved instead of ``A x = b``: x = offset + rest, ``A rest = load``.

    ``load (n,)`` is b − A offset, and the residual of x is load − A rest. Both avoid the cancellation that
    occurs for an offset far above the rest.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.problems import Lifting
    >>> lifting = Lifting(offset=np.array([100.0]), rest=np.array([0.5]), load=np.array([1.0]))
    >>> lifting.offset + lifting.rest
    array([100.5])
    """

    offset: Float
    rest: Float
    load: Float


@deferrable("A", "operators")
@dataclass(frozen=True, eq=False, repr=False)
class Solution:
    """Solution ``x`` of ``A x = b``, with the solver's report.

    Matrices are sparse, arrays or ``scipy.sparse.linalg.LinearOperator``. Solvers with another internal
    format pass ``A`` and ``operators`` as :class:`~agglo_core.problems.solution.Deferred`. ``operators``
    lists ``(A, P)`` per level, finest first. ``residuals`` are the 2-norms ‖b − A x‖ before the first and
    after each iteration. For several right-hand sides ``b (n, k)``, x is ``(n, k)``, ``columns`` has the
    history of each column, and ``residuals``, ``iterations`` and ``reason`` belong to the worst column: a
    column that has not converged if there is any, then the column with most iterations. All other attributes
    hold for all columns.

    Optional attributes:

    - ``tests``: passed tests, ``"residual"`` and ``"energy error"``, with the bound ``tolerance``;
    - ``energy_error``: estimate of the relative error in the energy norm, with ``energy_errors`` for each
      iterate, as ``residuals``;
    - ``lifting``: offset that was subtracted from x (``residuals`` then belong to the rest);
    - ``operator_complexity``, ``grid_complexity``: entries and unknowns of all levels over those of the
      finest;
    - ``parts``: agglomerate count for each level in ``operators``, None for unknowns without
      agglomerates;
    - ``memory``: size of the preconditioner in bytes;
    - ``seconds``, ``cpu_seconds``: wall and CPU time of the phases ``"hierarchy"`` (if built by the solver),
      ``"assemble"``, ``"setup"`` and ``"solve"``;
    - ``choice``: chosen recipe, with reason;
    - ``advice``: hint at a better method;
    - ``problem``, ``discretisation``, ``mesh``: interpretation of x, the last two None for linear systems.
      :func:`agglo_core.solve` adds them if the solver does not.

    ``rounding_limited`` is the third outcome beside converged and not converged: x misses ``tolerance``, but
    no solver in double precision does better. The evidence is ``backward_error``
    (:func:`~agglo_core.problems.residuals.backward_error.backward_error`). The accuracy of x is
    ``energy_error``.

    Examples
    --------
    >>> mesh = agglo.samples.squares(8)
    >>> solution = agglo.solve(mesh, agglo.Diffusion(source=8.0), solver="direct", degree=1)
    >>> solution.converged, solution.x.shape
    (True, (192,))
    """

    x: Float
    A: Any
    b: Float
    operators: list[tuple[Any, Any]]
    residuals: Float
    converged: bool
    reason: str
    iterations: int
    seconds: Mapping[str, float]
    energy_error: float | None = None
    tests: tuple[str, ...] = ()
    lifting: Lifting | None = None
    operator_complexity: float | None = None
    grid_complexity: float | None = None
    parts: tuple[int | None, ...] = ()
    memory: int | None = None
    cpu_seconds: Mapping[str, float] = field(default_factory=dict)
    choice: str = ""
    advice: str = ""
    tolerance: float | None = None
    energy_errors: Float = field(default_factory=empty_array)
    backward_error: float | None = None
    rounding_limited: bool = False
    discretisation: Discretisation | None = None
    mesh: Mesh | None = None
    problem: Problem | None = None
    columns: tuple[History, ...] = ()

    @property
    def outcome(self) -> str:
        """Outcome in words: ``"converged"``, ``"limited by rounding"`` or ``"not converged"``."""
        if self.converged:
            return "converged"
        return "limited by rounding" if self.rounding_limited else "not converged"

    @property
    def contraction(self) -> float | None:
        """Geometric mean of the residual reduction factors, or None without iterations."""
        return mean_contraction(self.residuals)

    @property
    def asymptotic_contraction(self) -> float | None:
        """Contraction over the second half of the iterations (geometric mean), or None without iterations."""
        return mean_contraction(self.residuals, (len(self.residuals) - 1) // 2)

    def samples(self) -> Samples:
        """Return the solution as a function: its values at points in each cell, for plots and files.

        Elasticity has stresses, too.

        Raises
        ------
        OptionError
            If the solver does not interpret x, as for a linear system.

        Examples
        --------
        >>> samples = agglo.solve(agglo.samples.squares(8), agglo.Diffusion(source=8.0), degree=2).samples()
        >>> round(float(samples.values.max()), 2)  # in the middle of the square
        0.59
        """
        how, mesh = self._interpretation()
        samples, law = how.sample(mesh, self.x), getattr(self.problem, "stress", None)
        if law is None or samples.gradients is None:
            return samples
        owners = samples.cells[samples.simplices[:, 0]]
        return replace(samples, stresses=law(samples.gradients, owners, mesh.n_cells))

    def evaluate(self, points: Any) -> Float:
        """Return the values of the solution at points.

        Parameters
        ----------
        points : (q, d) float

        Returns
        -------
        (q,) or (q, d) float
            Numbers, or the vectors of elasticity. NaN outside the mesh. On a face, the cell with the lower
            number counts.

        Raises
        ------
        OptionError
            If the solver does not interpret x, as for a linear system.

        Examples
        --------
        >>> solution = agglo.solve(agglo.samples.squares(8), agglo.Diffusion(source=8.0), degree=2)
        >>> solution.evaluate([[0.5, 0.5], [2.0, 0.5]]).round(2)
        array([0.59,  nan])
        """
        how, mesh = self._interpretation()
        return how.evaluate(mesh, self.x, frozen_float(points))

    def gradient(self, points: Any = None) -> Float:
        """Return the gradient of the solution at points, or its mean over each cell.

        Parameters
        ----------
        points : (q, d) float, optional
            Default: means over the cells.

        Returns
        -------
        (q, d) or (q, d, d) float
            For vectors ∂u_i/∂x_j. NaN outside the mesh. On a face, the cell with the lower number counts.

        Raises
        ------
        OptionError
            If the solver does not interpret x, or its discretisation has no gradients.

        Examples
        --------
        >>> solution = agglo.solve(agglo.samples.squares(8), agglo.Diffusion(source=8.0), degree=2)
        >>> solution.gradient([[0.05, 0.5]]).shape, solution.gradient([[2.0, 0.5]])
        ((1, 2), array([[nan, nan]]))
        """
        gradient, mesh = self._optional("gradient")
        return frozen_float(gradient(mesh, self.x, None if points is None else frozen_float(points)))

    def stress(self, points: Any = None) -> Float:
        """Return the stress of a displacement at points, or its mean over each cell.

        Parameters
        ----------
        points : (q, d) float, optional
            Default: means over the cells.

        Returns
        -------
        (q, 3, 3) float
            In 2-D with the normal stress σ_zz of plane strain. NaN outside the mesh.

        Raises
        ------
        OptionError
            If the problem has no stress, or the solver does not interpret x.

        Examples
        --------
        >>> mesh = agglo.samples.squares(8)
        >>> solution = agglo.solve(mesh, agglo.Elasticity(force=(0.0, -1.0)))
        >>> solution.stress([[0.5, 0.5]]).shape, solution.stress().shape
        ((1, 3, 3), (64, 3, 3))
        """
        problem = self._known_problem()
        if not hasattr(problem, "stress"):
            raise OptionError(f"a problem of kind {problem.kind} has no stress, only a gradient")
        locate, mesh = self._optional("locate")
        gradients = self.gradient(points)
        cells = np.arange(mesh.n_cells) if points is None else locate(mesh, frozen_float(points))
        return frozen_float(problem.stress(gradients, frozen_int(cells), mesh.n_cells))

    def fluxes(self) -> Float:
        """Return the numerical flux ∫ −κ ∂u/∂n + (b·n) u through each face, outward of the face's first cell.

        It is the flux that the discretisation uses: −{κ∇u}·n + γσ[u] on inner faces for ``polydg``, with the
        boundary values on Dirichlet faces, α u − g on Robin faces, and minus the given fluxes on Neumann
        faces. Convection adds (b·n) u with u from upstream, if b is free of divergence: otherwise b·∇u has
        no flux, and sums contain the integral of u div b. The fluxes out of a cell therefore sum to the
        integral of its source less reaction. With an iterative solver they do up to its residual: the
        smaller the tolerance, the better.

        For elasticity it is the force ∫ σ(u)n on the first cell, n outward: forces on a cell balance its body
        force.

        Returns
        -------
        (n_faces,) or (n_faces, d) float
            By the faces of the mesh. ``mesh.face_cells[f, 0]`` is the first cell of face f.

        Raises
        ------
        OptionError
            If the solver does not interpret x, or its discretisation has no fluxes.

        Examples
        --------
        >>> mesh = agglo.samples.squares(8)
        >>> fluxes = agglo.solve(mesh, agglo.Diffusion(source=8.0), tolerance=1e-10).fluxes()
        >>> round(float(fluxes[mesh.outer_faces].sum()), 8)  # the source of the unit square
        8.0
        """
        fluxes, mesh = self._optional("fluxes")
        return frozen_float(fluxes(self._known_problem(), mesh, self.x))

    def integral(self, tag: str | None = None, value: int | None = None) -> Any:
        """Return the integral of the solution over the mesh, or over the cells with a value of a cell tag.

        It is a number, or a vector ``(d,)`` for elasticity.

        Parameters
        ----------
        tag : str, optional
            Cell tag, such as ``"material"``. Default: all cells.
        value : int, optional
            Value of the tag.

        Raises
        ------
        OptionError
            For an unknown tag or value, a tag without value, or a solver that does not interpret x.

        Examples
        --------
        >>> solution = agglo.solve(agglo.samples.squares(8), agglo.Diffusion(source=8.0), degree=2)
        >>> round(solution.integral(), 3)
        0.281
        """
        integrals, mesh = self._optional("integrals")
        total = integrals(mesh, self.x)[_cells_with(mesh, tag, value)].sum(axis=0)
        return total if np.ndim(total) else float(total)

    def errors(self) -> dict[str, float]:
        """Return norms of the error against the problem's exact solution, as printed by ``agglo solve``.

        Norms are absolute. The names are those of the discretisation: ``"l2"`` and ``"dg"`` for ``polydg``.

        Raises
        ------
        OptionError
            If the problem has no exact solution, or the solver does not interpret x, as for a linear system.

        Examples
        --------
        >>> from agglo_core.problems.diffusion import sine
        >>> errors = agglo.solve(agglo.samples.squares(8), sine(), degree=2).errors()
        >>> sorted(errors), round(errors["l2"], 4)
        (['dg', 'l2'], 0.0005)
        """
        how, mesh = self._interpretation()
        problem = self._known_problem()
        norms = {name: float(value) for name, value in how.errors(problem, mesh, self.x).items()}
        if not norms:
            raise OptionError(
                f"the problem of kind {problem.kind} has no exact solution to compare with, such as "
                "Diffusion(…, exact=u) has"
            )
        return norms

    def transfer(self, old: Cut, new: Cut) -> Solution:
        """Return the L2 projection of the solution from the mesh of a cut to that of another cut.

        It preserves the integral. Where parts are divided the function stays as it is. ``A``, ``b`` and the
        report still belong to the solved system, and ``problem`` is None: its data may be given by part.

        Parameters
        ----------
        old, new : Cut
            Cuts of one hierarchy; the solution is on ``old.mesh``.

        Raises
        ------
        OptionError
            If the solution is not on ``old.mesh``, the cuts belong to different hierarchies, or the
            discretisation has no method ``transfer``.

        Examples
        --------
        >>> hierarchy = agglo.agglomerate(agglo.samples.squares(8), n_parts=(16, 4))
        >>> old, new = hierarchy.cut_at(1), hierarchy.cut(12)
        >>> solution = agglo.solve(hierarchy.above(old), agglo.Diffusion(source=8.0), degree=2)
        >>> moved = solution.transfer(old, new)
        >>> len(solution.x), len(moved.x), abs(moved.integral() - solution.integral()) < 1e-12
        (24, 60, True)
        """
        method, mesh = self._optional("transfer")
        if mesh is not old.mesh:
            raise OptionError(f"the solution is on {mesh}, not on the mesh of the first cut, {old.mesh}")
        moved = copy(self)  # dataclasses.replace would compute the deferred fields
        x = frozen_float(method(mesh, self.x, new.mesh, old.overlaps(new)))
        vars(moved).update(x=x, mesh=new.mesh, problem=None, lifting=None)
        return moved

    def write(self, path: str | PathLike[str]) -> None:
        """Write solution, gradient and stress for ParaView, as ``agglo solve -o`` does.

        They are sampled in every cell. A polyhedron that is not star-shaped is written as it is, with values
        at its vertices and without gradient and stress.

        Parameters
        ----------
        path : path-like
            File with the suffix ``.vtu``. An existing file is replaced.

        Raises
        ------
        FileError
            For another suffix, or a file that cannot be written.
        OptionError
            If the solver does not interpret x, as for a linear system.

        Examples
        --------
        >>> agglo.solve(agglo.samples.squares(8), degree=1).write("u.vtu")
        """
        _, mesh = self._interpretation()
        import_function("agglo_core.io.vtk.solution:write_solution")(path, mesh, self.samples())

    def write_fluxes(self, path: str | PathLike[str]) -> None:
        """Write the faces of the mesh with their :meth:`fluxes`, as ``agglo solve --fluxes`` does.

        Parameters
        ----------
        path : path-like
            File with the suffix ``.vtu``. Cell data of its lines or polygons: ``flux``, ``flux_density``
            (flux by face measure), for elasticity ``force`` and ``traction`` instead, ``first_cell``,
            ``second_cell`` (−1 outside), and the face tags.

        Raises
        ------
        FileError
            For another suffix, or a file that cannot be written.
        OptionError
            As :meth:`fluxes`.

        Examples
        --------
        >>> agglo.solve(agglo.samples.squares(8), degree=1).write_fluxes("fluxes.vtu")
        """
        import_function("agglo_core.io.vtk.solution:write_fluxes")(path, self.mesh, self.fluxes())

    def _known_problem(self) -> Problem:
        if self.problem is None:
            raise OptionError("the solver recorded no problem: call agglo.solve, which adds it")
        return self.problem

    def _optional(self, name: str) -> tuple[Callable[..., Any], Mesh]:
        """Return an optional method of the discretisation, and the mesh."""
        how, mesh = self._interpretation()
        method = getattr(how, name, None)
        if method is None:
            raise OptionError(f"the discretisation {type(how).__name__} has no method {name}")
        return method, mesh

    def _interpretation(self) -> tuple[Discretisation, Mesh]:
        if self.discretisation is None or self.mesh is None:
            raise OptionError(
                "x can be evaluated on a mesh only for problems that the solver discretises, not for "
                "linear systems; plot(convergence=True) shows the convergence"
            )
        return self.discretisation, self.mesh

    def plot(
        self, ax: Any = None, *, convergence: bool = False, across: str = "z", cmap: str = "viridis"
    ) -> Any:
        """Draw the solution on matplotlib axes: on the mesh in 2-D, on a plane through the middle in 3-D.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Default: axes of a new pyplot figure, shown by notebooks and ``plt.show()``.
        convergence : bool
            Draw residuals, relative to the first, and energy errors of the iterates instead.
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
            Without matplotlib, for 3-D axes or an invalid argument, or for x without interpretation, as
            of a linear system (except with ``convergence``).

        Examples
        --------
        >>> import agglo_core as agglo
        >>> solution = agglo.solve(agglo.samples.squares(8), agglo.Diffusion(source=8.0), degree=1)
        >>> solution.plot().get_xlabel()
        'x'
        >>> solution.plot(convergence=True).get_xlabel()
        'iteration'
        """
        if convergence:
            return import_function("agglo_core.draw.on_axes:plot_convergence")(self, ax)
        return import_function("agglo_core.draw.on_axes:plot_solution")(self, ax, across=across, cmap=cmap)

    @property
    def levels(self) -> LevelTable:
        """Table of unknowns and matrix entries per level, with a single level for solvers without levels."""
        matrices = [A for A, _ in self.operators] or [self.A]
        return LevelTable([A.shape[0] for A in matrices], [_entries(A) for A in matrices])

    def __repr__(self) -> str:
        """Return a line of text with size, outcome and cost."""
        steps = f"{self.iterations} iteration{'' if self.iterations == 1 else 's'}"
        sides = f", {self.x.shape[1]} right-hand sides" if self.x.ndim == 2 else ""
        parts = [f"{self.x.shape[0]} unknowns{sides}", f"{self.outcome} after {steps}"]
        if len(self.residuals) > 1 and self.residuals[0] > 0.0:
            parts.append(f"residual {self.residuals[-1] / self.residuals[0]:.1e}")
        if self.energy_error is not None:
            parts.append(f"energy error {self.energy_error:.1e}")
        if self.cpu_seconds or self.seconds:
            clock, spent = ("CPU s", self.cpu_seconds) if self.cpu_seconds else ("s", self.seconds)
            parts.append(f"{sum(spent.values()):.2g} {clock}")
        return f"Solution({', '.join(parts)})"

    def _repr_html_(self) -> str:
        html: str = import_function("agglo_core.draw.notebook:solution_html")(self)
        return html


def _cells_with(mesh: Mesh, tag: str | None, value: int | None) -> Mask:
    """Return the mask ``(n_cells,)`` of the cells with a tag value, or of all cells."""
    if tag is None and value is None:
        return np.ones(mesh.n_cells, bool)
    if tag is None or value is None:
        raise OptionError(f"give a cell tag and its value, or neither; given tag {tag!r} and value {value!r}")
    if tag not in mesh.cell_tags:
        raise OptionError(f"the mesh has no cell tag {tag!r}; it has: {', '.join(mesh.cell_tags) or 'none'}")
    chosen = mesh.cell_tags[tag] == value
    if not np.any(chosen):
        raise OptionError(f"no cell has the value {value!r} of the tag {tag!r}")
    return np.asarray(chosen)


def _entries(A: Any) -> int:
    """Return the number of stored entries, or rows times columns without sparse storage."""
    return int(A.nnz) if hasattr(A, "nnz") else int(A.shape[0]) * int(A.shape[1])
