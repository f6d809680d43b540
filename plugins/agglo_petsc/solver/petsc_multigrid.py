"""The solver ``petsc_mg``: a problem by PETSc, preconditioned by PCMG on agglomerates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import (
    Deferred,
    Diffusion,
    Float,
    Hierarchy,
    Listener,
    OptionError,
    Problem,
    Registry,
    Solution,
    default,
    distributed,
    limit_told,
    phase,
    solvers,
)
from agglo_petsc.ksp.checked_solve import solve
from agglo_petsc.ksp.level_report import level_matrices, level_sizes, memory_of
from agglo_petsc.ksp.option_database import parsed_options
from agglo_petsc.ksp.pcmg import (
    COARSE_SOLVERS,
    CYCLES,
    SMOOTHERS,
    CoarseSolver,
    Cycle,
    Smoother,
    chosen_smoother,
    setup,
)
from agglo_petsc.matrices import entries, petsc
from agglo_petsc.solver.across_ranks import AcrossRanks, solved_across
from agglo_petsc.solver.posed_systems import PosedSystem, posed, solution_of
from agglo_petsc.solver.system_on_ranks import COARSENINGS, Coarsening, SystemOnRanks, on_ranks

_OURS = {
    "ksp_rtol": "tolerance",
    "ksp_atol": "tolerance",
    "ksp_divtol": "tolerance",
    "ksp_norm_type": "tolerance",
    "ksp_max_it": "max_iterations",
}
"""Options of PETSc that this solver has its own word for."""


class PetscMultigrid:
    """Conjugate gradients of PETSc, preconditioned by its multigrid ``PCMG`` on our levels.

    Prolongations are made here and coarse matrices by PETSc, as Galerkin products. Of a diffusion problem the
    coarse functions are polynomials on the agglomerates, smoothed by a step of block Jacobi. Converged is
    said when the true residual and an estimate of the energy error are ``tolerance`` or less.

    Parameters
    ----------
    degree : int
        Of the polynomials, 1..6.
    tolerance : float
    max_iterations : int
    smoother : "auto", "sweeps", "patches", "blocks" or "sor"
        Our sweeps through vertex patches (in 3-D part by part); the same patches all at once by PETSc's
        ``PCASM``, its block Jacobi, or its SOR, these under Chebyshev's iteration.
    coarsening : "auto", "agglomerates" or "matrix"
        Of linear systems ``auto`` is ``matrix`` on one rank: aggregates of strongly coupled parts, in which
        agglomerates are kept as far as they suit the matrix.
    coarse_solver : "auto", "lu", "mumps", "superlu_dist" or "redundant"
    cycle : "V" or "W"
    levels : int, optional
        How many of mesh, level 0, 1, … to use; by default all. For a diffusion problem without levels some
        of 8 cells to an agglomerate are made.
    penalty : float, "paper" or "sharp"
        Of the jumps of PolyDG.
    ranks : "one" or "world"
        Whether this process solves alone; or all processes of the program together, each of which calls
        ``solve`` with the same problem and hierarchy, has the rows of some cells, and gets all of x.
    petsc_options : str or mapping
        PETSc's own options, such as ``"-mg_levels_ksp_max_it 3 -ksp_monitor"``; one that nothing uses is an
        error.
    registry : Registry, optional
        Where ``polydg_mg`` is looked up, whose discretisation this is; by default that of the program.

    Raises
    ------
    OptionError
        For any other value.
    """

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "linear")
    needs_levels: ClassVar[bool] = False
    tells_progress: ClassVar[bool] = True
    galerkin: ClassVar[bool] = True

    def __init__(
        self,
        degree: int = 1,
        tolerance: float = 1e-6,
        max_iterations: int = 300,
        smoother: Smoother = "auto",
        coarsening: Coarsening = "auto",
        coarse_solver: CoarseSolver = "auto",
        cycle: Cycle = "V",
        levels: int | None = None,
        penalty: float | Literal["paper", "sharp"] = "sharp",
        ranks: Literal["one", "world"] = "one",
        petsc_options: Any = "",
        *,
        registry: Registry | None = None,
    ) -> None:
        for name, value, known in (
            ("smoother", smoother, SMOOTHERS),
            ("coarsening", coarsening, COARSENINGS),
            ("coarse_solver", coarse_solver, COARSE_SOLVERS),
            ("cycle", cycle, CYCLES),
            ("ranks", ranks, ("one", "world")),
        ):
            if value not in known:
                raise OptionError(f"{name} must be one of {', '.join(known)}; given {value!r}")
        if levels is not None and not _whole(levels, 2):
            raise OptionError(f"levels must be a whole number, at least 2; given {levels!r}")
        if not _whole(max_iterations, 1):
            raise OptionError(f"max_iterations must be a whole number, at least 1; given {max_iterations!r}")
        if isinstance(tolerance, bool) or not isinstance(tolerance, int | float) or not 0.0 < tolerance < 1.0:
            raise OptionError(f"tolerance must be a number between 0 and 1; given {tolerance!r}")
        registry = default() if registry is None else registry
        self.discretisation = registry.build("discretisation", "polydg", degree=degree, penalty=penalty)
        self.degree, self.tolerance, self.max_iterations = degree, float(tolerance), max_iterations
        self.coarsening, self.levels, self.ranks = coarsening, levels, ranks
        self.smoother, self.coarse_solver, self.cycle = smoother, coarse_solver, cycle
        self.petsc_options = _options(petsc_options)

    def solve(self, problem: Problem, hierarchy: Hierarchy, progress: Listener | None = None) -> Solution:
        """Solve; ``converged`` and ``reason`` say how it ended, ``choice`` what the levels are.

        Raises
        ------
        OptionError
            If problem, hierarchy and options do not fit, or data are not finite.
        MeshError
            For a mesh of cells that overlap themselves.
        """
        watch, comm = solvers.Stopwatch(), self._comm()
        with watch("assemble"), phase(progress, "assembling"):
            system = posed(problem, hierarchy, self.discretisation, self.degree, self.levels)
        try:
            with watch("setup"), phase(progress, "setting up the levels"):
                there, ksp = self._set_up(system, comm)
        except np.linalg.LinAlgError as failure:
            return solution_of(
                system, solvers.unsolved(system.b, str(failure)), [(system.A, None)], watch, self.tolerance
            )
        with watch("solve"), phase(progress, "solving"):
            measure = system.measure
            history = solve(
                ksp,
                there.b,
                tolerance=self.tolerance,
                max_iterations=self.max_iterations,
                measure=None if measure is None else lambda own: measure(there.gathered(own)),
            )
        history = limit_told(replace(history, x=there.gathered(history.x)), system.A, system.b)
        alone, sizes = comm.getSize() == 1, level_sizes(ksp)
        operators: Any = Deferred(lambda: level_matrices(ksp)) if alone else [(system.A, None)]
        return replace(
            solution_of(system, history, operators, watch, self.tolerance),
            memory=memory_of(ksp),
            choice=self._choice(there),
            grid_complexity=sum(n for n, _ in sizes) / sizes[0][0],
            operator_complexity=sum(entries for _, entries in sizes) / sizes[0][1],
        )

    def solve_across(
        self,
        problem: Problem,
        hierarchy: distributed.DistributedHierarchy,
        progress: Listener | None = None,
    ) -> AcrossRanks:
        """Solve on a mesh of which each rank has its own cells; all ranks call it together.

        Raises
        ------
        OptionError
            As :func:`~agglo_petsc.solver.across_ranks.solve_across`; for a problem that is no ``Diffusion``.
        """
        if not isinstance(problem, Diffusion):
            raise OptionError(f"a {problem.kind} problem cannot be had of a mesh that lies on several ranks")
        if self.coarsening == "matrix":
            raise OptionError("coarsening 'matrix' is for one rank; on several take 'agglomerates'")
        return solved_across(
            problem,
            hierarchy,
            self.discretisation,
            self.degree,
            tolerance=self.tolerance,
            max_iterations=self.max_iterations,
            levels=self.levels,
            progress=progress,
            options={
                "smoother": self.smoother,
                "coarse_solver": self.coarse_solver,
                "cycle": self.cycle,
                "petsc_options": self.petsc_options,
            },
        )

    def aspreconditioner(self, problem: Problem, hierarchy: Hierarchy) -> LinearOperator:
        """One cycle ``(n, n)``, symmetric.

        Raises
        ------
        OptionError
            As :meth:`solve`, if the matrix is not positive definite, or on several ranks.
        MeshError
            As :meth:`solve`.
        """
        comm = self._comm()
        if comm.getSize() > 1:
            raise OptionError(
                "a preconditioner for scipy is of one rank; agglo_petsc.pc gives one of several"
            )
        system = posed(problem, hierarchy, self.discretisation, self.degree, self.levels)
        try:
            there, ksp = self._set_up(system, comm)
        except np.linalg.LinAlgError as failure:
            raise OptionError(f"there is no preconditioner for this matrix: {failure}") from failure
        b, x, pc = there.b.duplicate(), there.b.duplicate(), ksp.getPC()

        def applied(r: Float) -> Float:
            b.setArray(np.asarray(r, np.float64).ravel())
            pc.apply(b, x)
            return entries(x)

        return LinearOperator(system.A.shape, matvec=applied, rmatvec=applied, dtype=np.float64)

    def _comm(self) -> Any:
        PETSc = petsc()
        return PETSc.COMM_SELF if self.ranks == "one" else PETSc.COMM_WORLD

    def _set_up(self, system: PosedSystem, comm: Any) -> tuple[SystemOnRanks, Any]:
        """The system on its ranks, and a ``KSP`` ready for it."""
        there, ksp = on_ranks(system, comm, self.coarsening, self.smoother), petsc().KSP().create(comm)
        ksp.setOptionsPrefix(f"agglo_petsc_mg_{next(_SOLVES)}_")
        ksp.setOperators(there.A)
        ksp.setType("cg")
        how: Any = {
            "coarse_solver": self.coarse_solver,
            "cycle": self.cycle,
            "petsc_options": self.petsc_options,
        }
        setup(ksp, there.levels, smoother=self.smoother, **how)
        return there, ksp

    def _choice(self, there: SystemOnRanks) -> str:
        smoother = chosen_smoother(there.levels) if self.smoother == "auto" else self.smoother
        ranks = there.A.getComm().getSize()
        on = "one rank" if ranks == 1 else f"{ranks} ranks"
        return f"{there.choice}, {smoother}, {self.cycle}-cycle, PETSc on {on}"


_SOLVES = count()
"""Numbers of solvers, so that no two have one prefix of options."""


def _whole(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _options(given: str | Mapping[str, Any]) -> dict[str, str]:
    """PETSc's options, without those that this solver has an option of its own for."""
    found = parsed_options(given)
    for theirs, ours in _OURS.items():
        if theirs in found:
            raise OptionError(f"petsc_options: -{theirs} is the option {ours} here")
    return found
