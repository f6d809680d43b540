"""The solver ``petsc_mg``: PETSc's Krylov solver preconditioned by PCMG on agglomerates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import count
from typing import Any, ClassVar, Literal

import numpy as np
from scipy.sparse.linalg import LinearOperator

from agglo_core.authoring import (
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
    phase,
    solvers,
)
from agglo_core.problems.residuals.backward_error import explain_end
from agglo_core.problems.solution import Deferred
from agglo_petsc.ksp.checked_solve import solve
from agglo_petsc.ksp.level_report import level_matrices, level_sizes, memory_of
from agglo_petsc.ksp.option_database import parse_options
from agglo_petsc.ksp.pcmg import (
    COARSE_SOLVERS,
    CYCLES,
    SMOOTHERS,
    CoarseSolver,
    Cycle,
    Smoother,
    choose_smoother,
    setup,
)
from agglo_petsc.matrices import entries, petsc
from agglo_petsc.solver.across_ranks import AcrossRanks, solve_discretised
from agglo_petsc.solver.posed_systems import PosedSystem, pose_system, solution_of
from agglo_petsc.solver.system_on_ranks import COARSENINGS, Coarsening, SystemOnRanks, on_ranks

_OURS = {
    "ksp_rtol": "tolerance",
    "ksp_atol": "tolerance",
    "ksp_divtol": "tolerance",
    "ksp_norm_type": "tolerance",
    "ksp_max_it": "max_iterations",
}
"""PETSc options with a corresponding option in this solver."""


class PetscMultigrid:
    """Solve by PETSc's conjugate gradients, preconditioned by its multigrid ``PCMG`` on agglo levels.

    Agglo builds the prolongations, and PETSc the coarse matrices, as Galerkin products. For a diffusion
    problem the coarse functions are polynomials on the agglomerates, smoothed by a block Jacobi step. The
    solution counts as converged if the true residual and an estimate of the energy error are at most
    ``tolerance``.

    Parameters
    ----------
    degree : int
        Polynomial degree, 1..6.
    tolerance : float
    max_iterations : int
    smoother : "auto", "sweeps", "patches", "blocks" or "sor"
        Agglo's sweeps through vertex patches (in 3-D part by part); these patches with PETSc's ``PCASM``,
        its block Jacobi, or its SOR, the last three with Chebyshev's iteration.
    coarsening : "auto", "agglomerates" or "matrix"
        For linear systems on one rank ``auto`` is ``matrix``: aggregates of strongly coupled parts, which
        keep agglomerates as far as they suit the matrix.
    coarse_solver : "auto", "lu", "mumps", "superlu_dist" or "redundant"
    cycle : "V" or "W"
    levels : int, optional
        Number of levels to use from mesh, level 0, 1, …; by default all. For a diffusion problem without
        levels, agglomerates with 8 cells each are made.
    penalty : float, "paper" or "sharp"
        PolyDG jump penalty.
    ranks : "one" or "world"
        Whether this process solves alone, or all processes of the program together. In the latter case each
        process calls ``solve`` with equal problem and hierarchy, has the rows of some cells, and receives
        the whole x.
    petsc_options : str or mapping
        PETSc's own options, for example ``"-mg_levels_ksp_max_it 3 -ksp_monitor"``; an unused option is an
        error.
    registry : Registry, optional
        Registry for the discretisation of ``polydg_mg``; by default the program's.

    Raises
    ------
    OptionError
        For any other value.
    """

    accepts: ClassVar[tuple[str, ...]] = ("diffusion", "linear")
    needs_levels: ClassVar[bool] = False
    reports_progress: ClassVar[bool] = True
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
        for name, value, choices in (
            ("smoother", smoother, SMOOTHERS),
            ("coarsening", coarsening, COARSENINGS),
            ("coarse_solver", coarse_solver, COARSE_SOLVERS),
            ("cycle", cycle, CYCLES),
            ("ranks", ranks, ("one", "world")),
        ):
            if value not in choices:
                raise OptionError(f"{name} must be one of {', '.join(choices)}; given {value!r}")
        if levels is not None and not _is_integer_from(levels, 2):
            raise OptionError(f"levels must be a whole number, at least 2; given {levels!r}")
        if not _is_integer_from(max_iterations, 1):
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
        """Solve a problem on a hierarchy's mesh, with its levels as multigrid levels.

        The solution's ``converged`` and ``reason`` state the outcome, ``choice`` describes the levels.

        Raises
        ------
        OptionError
            If problem, hierarchy and options do not fit, or data are not finite.
        MeshError
            For a mesh with self-overlapping cells.
        """
        # 1. Assemble
        watch, comm = solvers.Stopwatch(), self._comm()
        with watch("assemble"), phase(progress, "assembling"):
            system = pose_system(problem, hierarchy, self.discretisation, self.degree, self.levels)
        # 2. Set up the levels
        try:
            with watch("setup"), phase(progress, "setting up the levels"):
                rank_system, ksp = self._set_up(system, comm)
        except np.linalg.LinAlgError as failure:
            return solution_of(
                system, solvers.unsolved(system.b, str(failure)), [(system.A, None)], watch, self.tolerance
            )
        # 3. Solve
        with watch("solve"), phase(progress, "solving"):
            measure = system.measure
            history = solve(
                ksp,
                rank_system.b,
                tolerance=self.tolerance,
                max_iterations=self.max_iterations,
                measure=None if measure is None else lambda local_r: measure(rank_system.gathered(local_r)),
            )
        history = explain_end(replace(history, x=rank_system.gathered(history.x)), system.A, system.b)
        alone, sizes = comm.getSize() == 1, level_sizes(ksp)
        operators: Any = Deferred(lambda: level_matrices(ksp)) if alone else [(system.A, None)]
        return replace(
            solution_of(system, history, operators, watch, self.tolerance),
            memory=memory_of(ksp),
            choice=self._choice(rank_system),
            grid_complexity=sum(n for n, _ in sizes) / sizes[0][0],
            operator_complexity=sum(entries for _, entries in sizes) / sizes[0][1],
        )

    def solve_across(
        self,
        problem: Problem,
        hierarchy: distributed.DistributedHierarchy,
        progress: Listener | None = None,
    ) -> AcrossRanks:
        """Solve a diffusion problem on a mesh distributed over ranks. Collective.

        Raises
        ------
        OptionError
            See :func:`~agglo_petsc.solver.across_ranks.solve_across`; also for a problem other than
            ``Diffusion``.
        """
        if not isinstance(problem, Diffusion):
            raise OptionError(
                "on a distributed mesh petsc_mg takes problems of kind diffusion; given one of kind "
                f"{problem.kind}"
            )
        if self.coarsening == "matrix":
            raise OptionError("coarsening 'matrix' needs one rank; use 'agglomerates' on several")
        return solve_discretised(
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
        """Return one multigrid cycle as a symmetric linear operator ``(n, n)``.

        Raises
        ------
        OptionError
            See :meth:`solve`; also if the matrix is not positive definite, or on several ranks.
        MeshError
            See :meth:`solve`.
        """
        comm = self._comm()
        if comm.getSize() > 1:
            raise OptionError("a SciPy preconditioner needs ranks='one'; use agglo_petsc.pc on several ranks")
        system = pose_system(problem, hierarchy, self.discretisation, self.degree, self.levels)
        try:
            rank_system, ksp = self._set_up(system, comm)
        except np.linalg.LinAlgError as failure:
            raise OptionError(f"the preconditioner cannot be set up for this matrix: {failure}") from failure
        b, x, pc = rank_system.b.duplicate(), rank_system.b.duplicate(), ksp.getPC()

        def applied(r: Float) -> Float:
            b.setArray(np.asarray(r, np.float64).ravel())
            pc.apply(b, x)
            return entries(x)

        return LinearOperator(system.A.shape, matvec=applied, rmatvec=applied, dtype=np.float64)

    def _comm(self) -> Any:
        PETSc = petsc()
        return PETSc.COMM_SELF if self.ranks == "one" else PETSc.COMM_WORLD

    def _set_up(self, system: PosedSystem, comm: Any) -> tuple[SystemOnRanks, Any]:
        """Distribute a system over ranks, and set up a ``KSP`` for it."""
        rank_system, ksp = on_ranks(system, comm, self.coarsening, self.smoother), petsc().KSP().create(comm)
        ksp.setOptionsPrefix(f"agglo_petsc_mg_{next(_SOLVES)}_")
        ksp.setOperators(rank_system.A)
        ksp.setType("cg")
        options: Any = {
            "coarse_solver": self.coarse_solver,
            "cycle": self.cycle,
            "petsc_options": self.petsc_options,
        }
        setup(ksp, rank_system.levels, smoother=self.smoother, **options)
        return rank_system, ksp

    def _choice(self, rank_system: SystemOnRanks) -> str:
        smoother = choose_smoother(rank_system.levels) if self.smoother == "auto" else self.smoother
        ranks = rank_system.A.getComm().getSize()
        on = "one rank" if ranks == 1 else f"{ranks} ranks"
        return f"{rank_system.choice}, {smoother}, {self.cycle}-cycle, PETSc on {on}"


_SOLVES = count()
"""Counter for unique PETSc option prefixes."""


def _is_integer_from(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _options(options: str | Mapping[str, Any]) -> dict[str, str]:
    """Parse PETSc options, and raise OptionError for options that have a counterpart in this solver."""
    values = parse_options(options)
    for petsc_name, option_name in _OURS.items():
        if petsc_name in values:
            raise OptionError(f"petsc_options: set the option {option_name} instead of -{petsc_name}")
    return values
