"""Diffusion problems for the default solver: system, multigrid levels and one right-hand side."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import (
    AggloError,
    Diffusion,
    Float,
    Hierarchy,
    History,
    Int,
    Mesh,
    Notify,
    OptionError,
    Solution,
    pcg,
    solvers,
)
from agglo_polydg_mg.forms.coefficients import cell_means, cell_tensors
from agglo_polydg_mg.forms.norms import EnergyNorm
from agglo_polydg_mg.polydg import Kept, PolyDG
from agglo_polydg_mg.solver.choose import Overrides, Plan, choose
from agglo_polydg_mg.solver.levels import build, cells_per_part
from agglo_polydg_mg.solver.numbering import Numbering, numbering_for
from agglo_polydg_mg.space.basis import Basis

_SHIFTS: Final = (0.0, 1e-12)  # of the levels only: above rounding errors, too small to weaken the cycle
_LARGEST_SHIFT: Final = 1e-10
"""Diagonal shifts, relative to the diagonal, tried in turn until the levels can be built."""


class Earlier(NamedTuple):
    """Parts of an earlier problem on a hierarchy that serve the next one, as far as they are given.

    Attributes
    ----------
    numbering : Numbering, optional
    basis : Basis, optional
        On the mesh in that numbering.
    plan : Plan, optional
        Describes levels that are kept.
    kept : Kept, optional
        Parts of an equal matrix.
    """

    numbering: Numbering | None = None
    basis: Basis | None = None
    plan: Plan | None = None
    kept: Kept | None = None


class DiffusionTask:
    """Diffusion problem discretised on a hierarchy's mesh, with its multigrid levels.

    Without the plan of an ``earlier`` problem the plan is made on first use. All arrays follow the cell
    ``numbering``.

    Raises
    ------
    OptionError, MeshError
        See :meth:`~agglo_polydg_mg.polydg.PolyDG.fine_system`.
    """

    def __init__(
        self,
        problem: Diffusion,
        hierarchy: Hierarchy,
        how: PolyDG,
        overrides: Overrides,
        count: int | None,
        earlier: Earlier | None = None,
    ) -> None:
        if hierarchy.fine is None:
            raise OptionError(
                "a diffusion problem requires a mesh, but this hierarchy belongs to a graph without a "
                "mesh: agglomerate the Mesh instead"
            )
        earlier = earlier or Earlier()
        self.numbering = earlier.numbering or numbering_for(hierarchy)
        self.problem, self.hierarchy = self.numbering.problem(problem), self.numbering.hierarchy
        self.count, self._overrides, self._plan = count, overrides, earlier.plan
        self._how, self._mesh, self._problem = how, hierarchy.fine, problem
        try:
            self.basis: Basis = earlier.basis or how.basis(self.numbering.mesh)
            self.fine = self._discretise(solvers.own_mesh(self.hierarchy), earlier.kept)
        except AggloError:
            if self.numbering.cells is not None:
                # Raise the error with the user's cell numbers
                how.fine_system(problem, solvers.own_mesh(hierarchy))
            raise

    def _discretise(self, mesh: Mesh, kept: Kept | None) -> solvers.FineSystem:
        """Discretise the problem on a mesh."""
        return self._how.fine_system(self.problem, mesh, self.basis, kept)

    def with_load(self, load: Float, plan: Plan | None = None) -> DiffusionTask:
        """Return the task with ``load (n,)``, in the user's numbering, added to the right-hand side.

        A ``plan`` describes existing levels.
        """
        task = copy(self)
        task.fine = self.fine.with_load(self.numbering.load(load))
        task._plan = plan or self._plan
        return task

    @property
    def kept(self) -> Kept | None:
        """Parts of the system that serve problems with an equal matrix, None for elasticity."""
        penalty, norm = self.fine.penalty, self.fine.measure.norm
        if penalty is None:
            return None
        return Kept(self.fine.A, penalty, norm if isinstance(norm, EnergyNorm) else None)

    @property
    def plan(self) -> Plan:
        """Plan of the multigrid levels."""
        if self._plan is None:
            self._plan = self._choose(self._overrides)
        return self._plan

    def _choose(self, overrides: Overrides) -> Plan:
        mesh, sigma, kappa = self.basis.mesh, self.fine.sigma, self.problem.kappa
        assert sigma is not None  # every discretised system has a penalty
        diagonal, tensors = self.fine.A.diagonal(), cell_tensors(mesh, kappa)
        return choose(mesh, sigma, cell_means(mesh, kappa), self.basis.degree, overrides, diagonal, tensors)

    def renew_plan(self) -> None:
        """Discard the plan, because levels are rebuilt for this problem."""
        self._plan = None

    @property
    def A(self) -> Any:
        """System matrix ``(n, n)``."""
        return self.fine.A

    @property
    def columns(self) -> list[Float]:
        """Right-hand sides, here a single one."""
        return [self.fine.b]

    @property
    def choice(self) -> str:
        """Description of the chosen levels, with the reason for them."""
        return self.plan.reason + self.numbering.remark

    @property
    def advice(self) -> str:
        """Advice to use a direct solver, if that would take less time."""
        return solvers.advice_of_multigrid(self.fine.A, self.plan.kind, 1, self.penalty)

    @property
    def penalty(self) -> float | str:
        """Penalty of the discretisation, as an option of solvers."""
        return self._how.penalty

    @property
    def cycle(self) -> str:
        """Multigrid cycle type: V, W, F or K."""
        return self.plan.cycle

    @property
    def single(self) -> bool:
        """True if cycles run in single precision."""
        return bool(self.plan.dtype == np.float32)

    def use_double(self) -> None:
        """Switch the plan to double precision."""
        if self.single:
            reason = f"{self.plan.reason}; double precision took over"
            self._plan = replace(self.plan, dtype=np.float64, reason=reason)

    def change_method(self) -> bool:
        """Switch to the next fallback method and return True, or return False if none is left.

        The first fallback is double precision. After that vertex patches follow, unless the user fixed
        the recipe.
        """
        if self.single:
            self.use_double()
            return True
        if self.plan.recipe == "patches" or self._overrides.recipe != "auto":
            return False
        failure = f"{self.plan.reason}, which failed"
        overrides = Overrides("patches", self._overrides.cycle, "double")
        plan = self._choose(overrides)
        self._plan = replace(plan, reason=f"{plan.reason} instead of: {failure}")
        self.__dict__.pop("labels", None)  # the previous recipe needed none
        return True

    @property
    def makes_levels(self) -> bool:
        """True if the hierarchy has no agglomerates although the recipe needs some.

        A recipe with a continuous space can aggregate vertices by the graph of their matrix.
        """
        return not self.hierarchy.levels and (self.plan.recipe != "conforming" or self.count is not None)

    @cached_property
    def labels(self) -> list[Int]:
        """Agglomerate of each cell on the coarse levels, finest first."""
        if self.hierarchy.levels:
            return solvers.chosen_levels(self.hierarchy, self.count)
        first = cells_per_part(self.plan, self.basis.degree)
        return solvers.default_levels(self.hierarchy, self.count, first) if self.makes_levels else []

    def stack(self) -> Any:
        """Build the multigrid levels, by a fallback method if rounding makes a block indefinite.

        Rounding may make the blocks of very flat cells indefinite. The levels are then built in double
        precision from a matrix with a slightly larger diagonal; the system to solve stays unchanged. If
        that fails too, another recipe is used, unless the user fixed the recipe.

        Raises
        ------
        LinAlgError
            If a matrix is not positive definite.
        """
        for more in _SHIFTS:
            try:
                return self._build_levels(self._shifted(more))
            except np.linalg.LinAlgError:
                self.use_double()
        self._plan = replace(
            self.plan,
            reason=(f"{self.plan.reason}; levels built with the diagonal increased by {_LARGEST_SHIFT:g}"),
        )
        try:
            return self._build_levels(self._shifted(_LARGEST_SHIFT))
        except np.linalg.LinAlgError:
            if not self.change_method():
                raise
        return self.stack()

    def _build_levels(self, fine: solvers.FineSystem) -> Any:
        """Build the levels of the plan for a system."""
        return build(self.plan, self.problem, fine, self.basis, self.labels)

    def _shifted(self, part: float) -> solvers.FineSystem:
        """Return the system with a multiple of its diagonal added to the matrix."""
        A = self.fine.A
        if part == 0.0:
            return self.fine
        larger = sparse.bsr_array(A + sparse.diags_array(part * A.diagonal()), blocksize=A.blocksize)
        larger.sort_indices()
        return self.fine._replace(A=larger)

    def preconditioner(self, M: LinearOperator) -> LinearOperator:
        """Convert a cycle to a preconditioner for the problem's matrix in the user's numbering."""
        return self.fine.preconditioner(self.numbering.operator(M))

    def parts(self, stack: Any) -> tuple[int | None, ...]:
        """Return the agglomerate count per level, None for levels with vertex unknowns."""
        below, cells = stack.levels[1:], self.hierarchy.graph.n
        if self.plan.recipe == "conforming":
            return cells, *(None for _ in below)
        return cells, *(int(each.labels.max()) + 1 for each in below)

    def iterate(
        self,
        M: LinearOperator,
        tolerance: float,
        most: int,
        before: Sequence[History] | None,
        notify: Notify,
        pace: float | None = None,
    ) -> list[History]:
        """Run preconditioned conjugate gradients, and return the convergence history in a list.

        The iteration continues from the end of the histories ``before``, if given.
        """
        measure = self.fine.measure
        history = pcg(
            self.fine.A,
            self.fine.b,
            M,
            before[0].x if before else None,
            tolerance=tolerance,
            most=most,
            stop="both",
            probe=False,
            pace=pace,
            measure=measure,
            energy=measure.energy,
            notify=notify,
        )
        return [history]

    def given_back(self, solution: Solution) -> Solution:
        """Return the solution on the user's mesh, in the user's numbering."""
        how: Any = self._how
        posed = replace(solution, discretisation=how, mesh=self._mesh, problem=self._problem)
        return self.numbering.solution(posed)

    def unsolved(self, reason: str) -> list[History]:
        """Return the convergence history of an iteration that could not start."""
        return [solvers.unsolved(self.fine.b, reason)]

    def solution(
        self,
        histories: Sequence[History],
        operators: list[tuple[Any, Any]],
        watch: solvers.Stopwatch,
        tolerance: float,
    ) -> Solution:
        """Return the solution that belongs to the given convergence histories."""
        return self.fine.solution(histories[0], operators, watch, tolerance)
