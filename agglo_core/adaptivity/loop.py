"""Adaptive solution: solve on a cut, estimate the error, refine where it is large, and repeat."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from math import log
from typing import Any, Final, Literal

import numpy as np

from agglo_core.adaptivity.marking import next_cut
from agglo_core.adaptivity.posing import PosedOnCuts, dual_problem
from agglo_core.agglomeration import agglomerate
from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import AggloError, OptionError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.hierarchy.cuts import Cut
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Field, Solution, require_accepted
from agglo_core.problems.solving import hierarchy_of, run_solver, solver_member
from agglo_core.progress import Listener, followed, phase
from agglo_core.registry import Registry, default, describe
from agglo_core.registry.attribution import Member, attributed
from agglo_core.registry.containment import shown
from agglo_core.registry.options import is_named, name_and_options
from agglo_core.suggestions import suggest_keywords

End = Literal["tolerance", "max_unknowns", "fine mesh", "solver"]
"""Reason for the end: the tolerance or the number of unknowns is reached, the mesh has no finer parts where
the error is, or a solver did not converge."""

_RATIO: Final = 4
"""Parts per part of the next coarser level, for hierarchies that are made for a mesh. 3 takes 14 % more time
and 9 % more unknowns at equal error (five layers, otherwise as in benchmarks/adaptivity.py time)."""
_FEWEST: Final = 16
"""Smallest mean number of parts on the coarsest of these levels. 32 takes 6 % less time, but 15 % more
unknowns at equal error (measured as the ratio)."""
_REGIONS: Final = 64
"""Largest number of coefficient values that are kept apart as regions."""


@dataclass(frozen=True)
class AdaptationStep:
    """One solve of an adaptation.

    Attributes
    ----------
    parts, unknowns : int
    estimate : float
        Estimated error in the energy norm, or of the goal.
    relative : float or None
        Estimate over the energy norm of the solution, or over the goal. None if the discretisation has no
        ``energy``, or for a goal no ``mass``.
    oscillation : float or None
        Share of the estimate due to data that polynomials cannot represent, None if unknown.
    errors : mapping of str to float
        Norms of the error against the exact solution; empty if that is unknown.
    iterations : int
    converged : bool
        Outcome of the solver.
    seconds : float
        Wall time of mesh, solve and estimate.
    """

    parts: int
    unknowns: int
    estimate: float
    relative: float | None
    oscillation: float | None
    errors: Mapping[str, float]
    iterations: int
    converged: bool
    seconds: float


@dataclass(frozen=True, eq=False, repr=False)
class Adaptation:
    """Result of :func:`adapt`.

    Attributes
    ----------
    steps : tuple of AdaptationStep
    solution : Solution
        Solution of the last step, on ``cut.mesh``.
    cut : Cut
        The adapted mesh.
    indicators : (n_parts,) float
        Estimated error in each of its parts.
    hierarchy : Hierarchy
        Hierarchy that the parts come from.
    reason : "tolerance", "max_unknowns", "fine mesh" or "solver"
        Reason for the end.

    Examples
    --------
    >>> found = agglo.adapt(agglo.samples.squares(16), max_unknowns=200)
    >>> found.reason, len(found.indicators) == found.cut.n_parts == found.steps[-1].parts
    ('max_unknowns', True)
    """

    steps: tuple[AdaptationStep, ...]
    solution: Solution
    cut: Cut
    indicators: Float
    hierarchy: Hierarchy
    reason: End

    @property
    def estimate(self) -> float:
        """Estimated error of the solution."""
        return self.steps[-1].estimate

    def __repr__(self) -> str:
        last = self.steps[-1]
        relative = "" if last.relative is None else f" ({last.relative:.1e} of the solution)"
        return (
            f"Adaptation({len(self.steps)} steps, {last.parts} parts of {self.hierarchy.graph.n} cells, "
            f"{last.unknowns} unknowns, estimate {last.estimate:.2e}{relative}, ended by {self.reason})"
        )


@suggest_keywords()
def adapt(
    on: Mesh | Hierarchy,
    problem: Diffusion | None = None,
    *,
    tolerance: float | None = None,
    max_unknowns: int | None = None,
    degree: int | None = None,
    estimator: str | tuple[str, Mapping[str, Any]] | Any = "residual",
    marking: float = 0.8,
    goal: Field | None = None,
    solver: str | tuple[str, Mapping[str, Any]] | Any = "polydg_mg",
    registry: Registry | None = None,
    progress: Listener | None = None,
    verbose: bool = False,
    **options: Any,
) -> Adaptation:
    """Solve a problem on a coarse mesh of agglomerates that is refined where the error is large.

    Each step solves on a cut of the hierarchy, starting from the solution of the last step, and estimates the
    error by part. Parts with large indicators are divided by up to three levels, siblings with small ones
    joined. Coarser levels precondition the solver.

    Parameters
    ----------
    on : Mesh or Hierarchy
        For a mesh, nested levels with ratio 4 are made, in which no part mixes coefficients given by cell.
    problem : Diffusion, optional
        Default: −Δu = 1 with u = 0 on the boundary. Coefficients and boundary data by cell are never
        averaged: parts in which they vary are divided before the first step.
    tolerance : float, optional
        Bound on the estimated error relative to the energy norm of the solution.
    max_unknowns : int, optional
        Largest number of unknowns. This or ``tolerance`` must be given.
    degree : int, optional
        Polynomial degree. Default: that of the solver.
    estimator : str, (str, options) or object with ``indicate(solution)``
    marking : float
        Share by which the squared estimate is predicted to fall in each step. Small values make more steps
        and slightly fewer unknowns.
    goal : Field, optional
        Weight ψ of a quantity ∫ ψ u. The error of this number is then estimated instead of the energy norm,
        by another solve per step, of the dual problem with source ψ, and ``tolerance`` is relative to the
        number.
    solver, registry, progress, verbose, **options
        As for :func:`agglo_core.solve`.

    Returns
    -------
    Adaptation
        Check ``reason``: a tolerance that is not reached raises no error.

    Raises
    ------
    OptionError
        For invalid arguments, hierarchies that are not nested or have no mesh, or a problem that estimator or
        solver refuse.
    PluginError
        If a component cannot be used, or fails.

    Examples
    --------
    >>> mesh = agglo.samples.voronoi(2000, seed=1)
    >>> peak = lambda x: 1000.0 * np.exp(-200.0 * ((x - 0.3) ** 2).sum(axis=1))
    >>> found = agglo.adapt(mesh, agglo.Diffusion(source=peak), tolerance=0.2, degree=2)
    >>> found.reason, found.steps[-1].parts < 200
    ('tolerance', True)
    """
    # 1. Check the arguments
    hierarchy = hierarchy_of(on, "adapt")
    problem = Diffusion() if problem is None else problem
    if not isinstance(problem, Diffusion):
        kind = getattr(problem, "kind", None)
        given = shown(problem) if kind is None else f"a problem of kind {kind}"
        raise OptionError(f"adapt solves problems of kind diffusion, given {given}")
    if hierarchy.fine is None:
        raise OptionError("adapt requires a hierarchy with a mesh: agglomerate the Mesh instead of its graph")
    known = default() if registry is None else registry
    given = options if degree is None else {"degree": degree, **options}
    member = solver_member(solver, given, known, adapt)
    _check_goals(tolerance, max_unknowns, marking)
    require_accepted(member.tool, problem, member.title)
    judge = _estimator_member(estimator, known)
    require_accepted(judge.tool, problem, judge.title)
    # 2. Levels and first cut
    posed = PosedOnCuts(problem, hierarchy.fine)
    dual = None if goal is None else PosedOnCuts(dual_problem(problem, goal), hierarchy.fine)
    with followed(progress, verbose) as listen:
        if isinstance(on, Mesh):
            hierarchy = _levels(posed, known, listen)
        loop = _Loop(posed, dual, hierarchy, member, judge, listen)
        return loop.run(tolerance, max_unknowns, float(marking))


class _Loop:
    """Steps of an adaptation, with the last cut and its solution."""

    def __init__(
        self,
        posed: PosedOnCuts,
        dual: PosedOnCuts | None,
        hierarchy: Hierarchy,
        solver: Member,
        judge: Member,
        listen: Listener | None,
    ) -> None:
        self.posed, self.hierarchy = posed, hierarchy
        self.solver, self.judge, self.listen = solver, judge, listen
        self.steps: list[AdaptationStep] = []
        self.before: tuple[Cut, Solution] | None = None
        self.dual = dual
        self.power = 2 if dual is None else 1  # of the estimate in the sum of squared indicators

    def run(self, tolerance: float | None, max_unknowns: int | None, share: float) -> Adaptation:
        """Solve, estimate and refine until a goal is reached."""
        cut = self._settled(self.hierarchy.cut_at(len(self.hierarchy) - 1))
        while True:
            solution, indicators = self._step(cut)
            last = self.steps[-1]
            if tolerance is not None and last.relative is None:
                raise OptionError(
                    f"the discretisation of {self.solver.title} has no method energy or mass, so a relative "
                    "tolerance cannot be tested: give max_unknowns instead"
                )
            found = cut, solution, frozen_float(indicators)
            if not (solution.converged or solution.rounding_limited):
                return self._ended(*found, "solver")
            if tolerance is not None and last.relative is not None and last.relative <= tolerance:
                return self._ended(*found, "tolerance")
            # Sum of squared indicators that meets the tolerance
            allowed = 0.0
            if tolerance is not None and last.relative:
                allowed = float((indicators**2).sum()) * (tolerance / last.relative) ** self.power
            most = np.inf if max_unknowns is None else max_unknowns * last.parts / last.unknowns
            finer = next_cut(cut, indicators**2, share, allowed, most)
            if finer is None:
                divisible = next_cut(cut, indicators**2, share, allowed) is not None
                return self._ended(*found, "max_unknowns" if divisible else "fine mesh")
            self.before, cut = (cut, solution), self._settled(finer)

    def _ended(self, cut: Cut, solution: Solution, indicators: Float, reason: End) -> Adaptation:
        return Adaptation(tuple(self.steps), solution, cut, indicators, self.hierarchy, reason)

    def _settled(self, cut: Cut) -> Cut:
        """Divide parts in which coefficients or boundary data by cell vary."""
        while True:
            mixed = self.posed.mixed_parts(cut)
            if not mixed.any():
                return cut
            cut = cut.refine(mixed).cut

    def _step(self, cut: Cut) -> tuple[Solution, Float]:
        """Solve on a cut and estimate the error of each part ``(n_parts,)``."""
        start = time.perf_counter()
        levels, problem = _coarser(self.hierarchy, cut), self.posed.on(cut)
        solution = run_solver(self.solver, problem, levels, self.listen, self._guess(cut))
        if solution.discretisation is None:
            raise OptionError(f"{self.solver.title} has no discretisation, so its error cannot be estimated")
        with phase(self.listen, "estimating"), attributed(self.judge.title, spare=(AggloError,)):
            indicators, oscillation = self._estimated(solution, cut, self.posed)
        if self.dual is None:
            energy = getattr(solution.discretisation, "energy", None)
            size = None if energy is None else float(np.sqrt(energy(problem, cut.mesh, solution.x)))
        else:
            indicators, size = self._weighted(solution, indicators, cut, self.dual)
        seconds = time.perf_counter() - start
        estimate = float((indicators**2).sum()) ** (1.0 / self.power)
        self.steps.append(
            AdaptationStep(
                parts=cut.n_parts,
                unknowns=len(solution.x),
                estimate=estimate,
                relative=None if size is None else estimate / size if size > 0.0 else float(estimate > 0.0),
                oscillation=oscillation,
                errors={} if problem.exact is None else solution.errors(),
                iterations=solution.iterations,
                converged=solution.converged,
                seconds=seconds,
            )
        )
        return solution, indicators

    def _weighted(
        self, solution: Solution, indicators: Float, cut: Cut, dual: PosedOnCuts
    ) -> tuple[Float, float | None]:
        """Return the geometric means of the indicators with those of the dual solution, and the goal.

        The sum of their squares bounds the error of ∫ ψ u as far as both indicators bound their errors.
        """
        solved = run_solver(self.solver, dual.on(cut), _coarser(self.hierarchy, cut), self.listen)
        with phase(self.listen, "estimating"), attributed(self.judge.title, spare=(AggloError,)):
            weights, _ = self._estimated(solved, cut, dual)
        project, mass = (getattr(solution.discretisation, name, None) for name in ("project", "mass"))
        if project is None or mass is None:
            return np.sqrt(indicators * weights), None
        psi = dual.on(cut).source
        field = project(
            cut.mesh, psi if callable(psi) else np.broadcast_to(np.asarray(psi, float), cut.n_parts)
        )
        return np.sqrt(indicators * weights), abs(float(field @ (mass(cut.mesh) @ solution.x)))

    def _estimated(self, solution: Solution, cut: Cut, posed: PosedOnCuts) -> tuple[Float, float | None]:
        """Return the indicators ``(n_parts,)`` of a solution, and the size of the data oscillation."""
        tool, averaged = self.judge.tool, posed.source_oscillation(cut)
        terms = dict(tool.terms(solution)) if hasattr(tool, "terms") else {}
        oscillation = terms.pop("oscillation", None)
        squares = sum(np.square(values) for values in terms.values())
        indicators = np.asarray(np.sqrt(squares) if terms else tool.indicate(solution), dtype=float)
        if indicators.shape != (cut.n_parts,) or not (indicators >= 0.0).all() or np.isinf(indicators).any():
            raise PluginError(
                f"{self.judge.title}: indicate returned {shown(indicators)}, expected {cut.n_parts} finite "
                "numbers that are not negative"
            )
        size = None if oscillation is None else float(np.linalg.norm(np.hypot(oscillation, averaged)))
        return np.hypot(indicators, averaged), size

    def _guess(self, cut: Cut) -> Float | None:
        """Return the last solution projected to a cut ``(n,)``, or None if there is none."""
        if self.before is None:
            return None
        old, solution = self.before
        transfer = getattr(solution.discretisation, "transfer", None)
        if transfer is None:
            return None
        return frozen_float(transfer(old.mesh, solution.x, cut.mesh, old.overlaps(cut)))


def _coarser(hierarchy: Hierarchy, cut: Cut) -> Hierarchy:
    """Return the levels above a cut that have at most half as many parts as the one before."""
    above, n, kept = hierarchy.above(cut), cut.n_parts, list[int]()
    for level, labels in enumerate(above.levels):
        if 2 * (int(labels.max()) + 1) <= n:
            n = int(labels.max()) + 1
            kept.append(level)
    levels, targets = [above.levels[level] for level in kept], [above.targets[level] for level in kept]
    return Hierarchy(cut.mesh, above.graph, levels, targets, nested=True)


def _levels(posed: PosedOnCuts, registry: Registry, listen: Listener | None) -> Hierarchy:
    """Agglomerate the mesh into nested levels for cuts, with equal coefficients in each part."""
    count = max(1, int(log(max(posed.mesh.n_cells / _FEWEST, 1.0)) / log(_RATIO)))
    sizes, regions = [float(_RATIO**k) for k in range(1, count + 1)], posed.regions
    kept = regions if regions is not None and regions.max() < _REGIONS else None
    return agglomerate(posed.mesh, cells_per_part=sizes, regions=kept, registry=registry, progress=listen)


def _estimator_member(estimator: Any, registry: Registry) -> Member:
    """Return an estimator built by name, or a given object after a check for its method ``indicate``."""
    if is_named(estimator):
        name, options = name_and_options("estimator", estimator)
        record = registry.record("estimator", name)
        return Member(registry.build("estimator", name, **options), describe(record))
    if isinstance(estimator, type) or not callable(getattr(estimator, "indicate", None)):
        raise OptionError(
            f"{shown(estimator)} is not an estimator: expected a name or an object with indicate(solution)"
        )
    return Member(estimator, f"estimator {type(estimator).__name__}")


def _check_goals(tolerance: Any, max_unknowns: Any, marking: Any) -> None:
    """Raise OptionError unless the goals of an adaptation are numbers in range."""
    if tolerance is None and max_unknowns is None:
        raise OptionError("adapt needs a goal: give tolerance, max_unknowns or both")
    for name, value in (("tolerance", tolerance), ("marking", marking)):
        if value is not None and not (isinstance(value, int | float | np.number) and 0.0 < value <= 1.0):
            raise OptionError(f"{name} must be a number above 0 and at most 1, given {value!r}")
    whole = isinstance(max_unknowns, int | np.integer) and not isinstance(max_unknowns, bool)
    if max_unknowns is not None and (not whole or max_unknowns < 1):
        raise OptionError(f"max_unknowns must be a positive whole number, given {max_unknowns!r}")
