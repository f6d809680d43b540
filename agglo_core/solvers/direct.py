"""Sparse direct solver with error estimate, the baseline for multigrid methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar, Literal, cast

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems import Linear, Problem, Solution
from agglo_core.problems.choosing import discretisation_for
from agglo_core.problems.iteration_history import MET, TESTS, History, unsolved
from agglo_core.problems.residuals.backward_error import explain_end
from agglo_core.problems.residuals.sizes import size_ratio, two_norm
from agglo_core.progress import Listener, phase
from agglo_core.registry import Registry
from agglo_core.solvers.advice import Kind, advice_of_direct
from agglo_core.solvers.backends import AUTO, BACKENDS, GENERAL_BACKENDS, Solves, choose_backend
from agglo_core.solvers.fine_system import FineSystem, chosen_discretisation, fine_system, may_be_nonsymmetric
from agglo_core.solvers.option_checks import require_count, require_fraction, show_options
from agglo_core.solvers.stopwatch import Stopwatch
from agglo_core.threads import one_blas_thread

Bound = Callable[[Float], float]
"""Maps a residual ``(n,)`` to a bound on the energy norm of the error."""

_STORED = ("indptr", "indices", "data")
_INVERSE_ITERATIONS = 4
_MARGIN = 10.0
"""Factor of the error bound. An eigenvalue too small by the square of this factor requires a start vector
whose part in the eigenvector is below 1e-7: each iteration multiplies that part by at least 100."""


class Direct:
    """Sparse direct solver for linear or discretised systems, with iterative refinement.

    The levels of the hierarchy are not used. An iteration is one solve with the factors, and the first nearly
    always suffices. The energy error is estimated by a further solve for the remaining residual. Factors
    that serve several systems bound it by the residual alone, after an estimate of the smallest eigenvalue,
    so that each system takes one solve. PARDISO or SuperLU factorise matrices that are not symmetric: of
    problems with convection, and of linear systems with ``symmetric=False``. Their systems take two solves.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1..6.
    tolerance : float
        Bound on the residual relative to the right-hand side (measured by
        :class:`~agglo_core.solvers.residual_measure.ResidualMeasure`) and on the energy error.
    max_refinements : int
        Maximum number of solves after the first.
    penalty : float, "paper" or "sharp"
        Jump penalty in the discretisation ``polydg``.
    scaled_basis : bool
        Scale the basis by each cell's bounding box. The paper does not.
    backend : "auto", "pardiso", "cholmod" or "superlu"
        See :mod:`~agglo_core.solvers.backends`. Default: the first installed solver.
    discretisation : str, tuple or object
        Name of a discretisation, name with options, or an object.
    registry : Registry, optional
        Registry with the discretisation. Default: the program's registry.

    Raises
    ------
    OptionError
        For an invalid value, or a backend that is not installed.
    """

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "elasticity", "linear")
    needs_levels: ClassVar[bool] = False
    reports_progress: ClassVar[bool] = True

    def __init__(
        self,
        degree: int = 1,
        tolerance: float = 1e-6,
        max_refinements: int = 3,
        penalty: float | Literal["paper", "sharp"] = 10.0,
        scaled_basis: bool = False,
        backend: str = AUTO,
        discretisation: str | tuple[str, Mapping[str, Any]] | Any = "polydg",
        *,
        registry: Registry | None = None,
    ) -> None:
        require_fraction("tolerance", tolerance)
        require_count("max_refinements", max_refinements, 0)
        choose_backend(backend)
        own, defaults = (
            {"penalty": penalty, "scaled_basis": scaled_basis},
            {"penalty": 10.0, "scaled_basis": False},
        )
        self.discretisation = chosen_discretisation(discretisation, registry, degree, own, defaults)
        self.tolerance, self.max_refinements, self.backend = tolerance, max_refinements, backend

    def __repr__(self) -> str:
        return show_options(self)

    def solve(self, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None) -> Solution:
        """Factorise the matrix and solve the system. ``converged`` and ``reason`` describe the outcome.

        Raises
        ------
        OptionError
            If problem and hierarchy do not fit, or data are not finite.
        MeshError
            For a mesh with self-overlapping cells.
        """
        return self.repeated(hierarchy).solve(problem, progress)

    def repeated(self, hierarchy: Hierarchy) -> RepeatedDirect:
        """Return a solver for a sequence of problems, which reuses the factors while the matrix is equal."""
        return RepeatedDirect(self, hierarchy)

    def _kind(self, problem: Problem, fine: FineSystem) -> Kind:
        """Return the kind of system for the advice: linear, or by the smoother that polydg_mg would use."""
        if isinstance(problem, Linear):
            return "linear"
        matrix_kind = getattr(discretisation_for(self.discretisation, problem), "matrix_kind", None)
        return "linear" if matrix_kind is None else cast("Kind", matrix_kind(problem, fine))

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> LinearOperator:
        """Return the inverse ``(n, n)`` as an operator, also for several right-hand sides ``(n, k)`` at once.

        Raises
        ------
        OptionError
            As :meth:`solve`, or if the matrix cannot be factorised.
        """
        fine = fine_system(problem, hierarchy, self.discretisation)
        try:
            solves = BACKENDS[choose_backend(self.backend)](fine.A)
        except np.linalg.LinAlgError as failure:
            raise OptionError(f"cannot precondition with the inverse of this matrix: {failure}") from failure
        inverse = LinearOperator(
            fine.A.shape, matvec=solves, rmatvec=solves, matmat=solves, rmatmat=solves, dtype=np.float64
        )
        return fine.preconditioner(inverse)


class RepeatedDirect:
    """Solve a sequence of problems on one mesh, and factorise only matrices that differ from the last.

    Create an instance by :meth:`Direct.repeated`.

    Attributes
    ----------
    setups : int
        Number of factorisations.

    Examples
    --------
    >>> from agglo_core.solvers.direct import Direct
    >>> mesh = agglo.samples.squares(8)
    >>> steps = Direct().repeated(agglo.agglomerate(mesh, n_parts=4))
    >>> all(steps.solve(agglo.Diffusion(source=float(k))).converged for k in range(3)), steps.setups
    (True, 1)
    """

    def __init__(self, solver: Direct, hierarchy: Hierarchy) -> None:
        self.setups = 0
        self._solver, self._hierarchy = solver, hierarchy
        self._system: FineSystem | None = None
        self._solves: Solves | None = None
        self._bound: Bound | None = None  # of the error, for factors in use again
        self._backends = BACKENDS
        self._symmetric = True
        self._energy = True  # whether errors may be measured in an energy norm
        self._advice = ""

    def solve(
        self, problem: Problem, progress: Listener | None = None, *, load: Float | None = None
    ) -> Solution:
        """Solve as :meth:`Direct.solve` does, with ``load (n,)`` added to the right-hand side if given."""
        watch, solver = Stopwatch(), self._solver
        with watch("assemble"), phase(progress, "assembling"):
            fine = fine_system(problem, self._hierarchy, solver.discretisation, nonsymmetric=True)
            self._symmetric = not may_be_nonsymmetric(problem)
            self._backends = BACKENDS if self._symmetric else GENERAL_BACKENDS
            self._energy = self._symmetric or not isinstance(problem, Linear)
            if self._system is None or not _equal_matrices(self._system.A, fine.A):
                self._solves = self._bound = None
            self._system = fine
        if self._solves is None:
            backend = choose_backend(solver.backend, self._backends)
            kind = solver._kind(problem, fine)
            self._advice = advice_of_direct(fine.A, kind, backend) if self._energy else ""
        return self._solve(fine if load is None else fine.with_load(load), watch, progress)

    def solve_again(self, load: Float, progress: Listener | None = None) -> Solution:
        """Solve the last problem of :meth:`solve` with another ``load (n,)`` added, without assembling.

        Raises
        ------
        OptionError
            Without such a problem, or for a linear system.
        """
        if self._system is None:
            raise OptionError("no problem has been solved yet: call solve first")
        return self._solve(self._system.with_load(load), Stopwatch(), progress)

    def _solve(self, fine: FineSystem, watch: Stopwatch, progress: Listener | None) -> Solution:
        solver = self._solver
        try:
            if self._solves is None:
                backend = choose_backend(solver.backend, self._backends)
                with watch("setup"), phase(progress, "factorising", backend):
                    self._solves = self._backends[backend](fine.A)
                self.setups += 1
            elif self._bound is None and self._symmetric:
                with watch("setup"), phase(progress, "bounding errors"):
                    self._bound = _error_bound(fine.A, self._solves)
            with watch("solve"), phase(progress, "solving"):
                options = solver.tolerance, solver.max_refinements, self._energy, self._bound
                history = _solve_and_refine(fine, self._solves, *options)
        except np.linalg.LinAlgError as failure:
            history = unsolved(fine.b, str(failure))
        solution = fine.solution(history, [(fine.A, None)], watch, solver.tolerance)
        return replace(solution, advice=self._advice)


def _equal_matrices(A: Any, B: Any) -> bool:
    """Return True if two sparse matrices have equal entries at equal places."""
    same = A.format == B.format and A.shape == B.shape
    return same and all(np.array_equal(getattr(A, name), getattr(B, name)) for name in _STORED)


def _error_bound(A: Any, solves: Solves) -> Bound:
    """Return a bound on the energy norm of A⁻¹r by the residual ``r (n,)``, which takes no further solve.

    ‖A⁻¹r‖_A² = r·A⁻¹r ≤ λ r·D⁻¹r with the diagonal D of A and the largest eigenvalue λ of A⁻¹D, which is
    estimated by inverse iteration. The bound is ∞ if A proves not to be positive definite.
    """
    diagonal = A.diagonal()
    if not (diagonal > 0.0).all():
        return lambda r: np.inf
    v, eigenvalue = np.random.default_rng(0).standard_normal(len(diagonal)), 1.0
    for _ in range(_INVERSE_ITERATIONS):
        w = solves(diagonal * v)
        eigenvalue = float(np.sqrt((w @ (diagonal * w)) / (v @ (diagonal * v))))
        if not (w @ (diagonal * v) > 0.0 and 0.0 < eigenvalue < np.inf):
            return lambda r: np.inf
        v = w / eigenvalue
    return lambda r: _MARGIN * float(np.sqrt(eigenvalue * (r @ (r / diagonal))))


def _solve_and_refine(
    fine: FineSystem, solves: Solves, tolerance: float, most: int, has_energy: bool, bound: Bound | None
) -> History:
    """Solve, then refine at most ``most`` times until residual and error are within the tolerance."""
    b = fine.b
    x = np.zeros(len(b))
    with one_blas_thread():
        residuals = [two_norm(b)]
        size, error, energy = (fine.measure(b), np.inf, True) if b.any() else (0.0, 0.0, True)
    correction = solves(b)
    while not (size <= tolerance and error <= tolerance) and len(residuals) <= most + 1:
        # Refinement: add corrections as long as the residual decreases.
        better = x + correction
        if not np.isfinite(better).all():
            raise np.linalg.LinAlgError("the factorisation broke down: the matrix is singular, or nearly so")
        with one_blas_thread():  # vectors are too short for several
            r = b - fine.A @ better
            new_size = fine.measure(r)
            if not new_size < size:
                break
            x, size = better, new_size
            residuals.append(two_norm(r))
            # Error: by the bound if that suffices, else by a solve.
            if bound is not None and b @ x >= 0.0:
                error, energy = size_ratio(bound(r), fine.measure.energy(x)), True
        if not (size <= tolerance and error <= tolerance):
            correction = solves(r)
            error, energy = _error(fine, x, r, correction, has_energy)
    # Outcome: both tests passed, or the residual stagnates.
    outcomes = (size <= tolerance, error <= tolerance)
    met = tuple(name for name, ok in zip(TESTS, outcomes, strict=True) if ok and (energy or name != TESTS[1]))
    estimate = error if energy and np.isfinite(error) else None
    iterates = (frozen_float(x), frozen_float(residuals))
    if all(outcomes):
        return History(*iterates, True, MET, estimate, met, "met")
    sizes = f"relative residual {size:.1e}, error about {error:.1e} after {len(residuals) - 1} iterations"
    sizes = f"{sizes}, required {tolerance:.1e}"
    # Attribute stagnation to rounding if the backward error allows, else to a singular matrix.
    history = explain_end(History(*iterates, False, sizes, estimate, met, "stagnation"), fine.A, b)
    if history.final:
        return history
    joints = history.reason.removeprefix(sizes)
    return replace(history, reason=f"{sizes}: the matrix is singular, or nearly so{joints}")


def _error(fine: FineSystem, x: Float, r: Float, correction: Any, has_energy: bool) -> tuple[float, bool]:
    """Return the relative error estimated by the correction, and True if measured in the energy norm.

    A negative product δ·r or b·x means that A has no energy norm, as matrices that need not be symmetric.
    Then 2-norms are compared.
    """
    square = float(correction @ r)
    if not has_energy or square < 0.0 or float(fine.b @ x) < 0.0:
        return size_ratio(two_norm(correction), two_norm(x)), False
    return size_ratio(float(np.sqrt(square)), fine.measure.energy(x)), True
