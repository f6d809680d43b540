"""Set-up of PETSc's multigrid ``PCMG`` on agglo levels, for any ``KSP``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from agglo_core.authoring import OptionError, Patches
from agglo_petsc.ksp.option_database import OptionDatabase, parse_options
from agglo_petsc.levels.aggregates import Levels, PetscLevels, levels_for
from agglo_petsc.matrices import petsc
from agglo_petsc.ranks.patch_sweeps import LevelSweeps, PatchSweeps, require_width

Smoother = Literal["auto", "sweeps", "patches", "blocks", "sor"]
CoarseSolver = Literal["auto", "lu", "mumps", "superlu_dist", "redundant"]
Cycle = Literal["V", "W"]
SMOOTHERS: Final = ("auto", "sweeps", "patches", "blocks", "sor")
COARSE_SOLVERS: Final = ("auto", "lu", "mumps", "superlu_dist", "redundant")
CYCLES: Final = ("V", "W")

_CHEBYSHEV: Final = {"mg_levels_ksp_type": "chebyshev", "mg_levels_esteig_ksp_type": "cg"}
_BY_SMOOTHER: Final[dict[str, dict[str, str]]] = {
    "sweeps": {"mg_levels_ksp_type": "richardson", "mg_levels_ksp_max_it": "1"},
    "patches": {
        **_CHEBYSHEV,
        "mg_levels_ksp_max_it": "2",
        "mg_levels_pc_asm_type": "basic",
        "mg_levels_sub_pc_type": "cholesky",
    },
    "blocks": {**_CHEBYSHEV, "mg_levels_ksp_max_it": "2", "mg_levels_pc_type": "pbjacobi"},
    "sor": {**_CHEBYSHEV, "mg_levels_ksp_max_it": "2", "mg_levels_pc_type": "sor"},
}


def setup(
    ksp: Any,
    levels: Levels,
    *,
    smoother: Smoother = "auto",
    coarse_solver: CoarseSolver = "auto",
    cycle: Cycle = "V",
    petsc_options: str | Mapping[str, Any] = "",
) -> None:
    """Set up multigrid on agglo levels as the preconditioner for a given ``KSP``. Collective.

    The ``KSP`` itself is set up, too. Coarse matrices are Galerkin products, recomputed by PETSc when the
    matrix changes. All else in the ``KSP``, its type and tolerances, stays unchanged. Options in PETSc's
    database under the prefix of the ``KSP`` take precedence over agglo's defaults.

    Parameters
    ----------
    ksp : petsc4py.PETSc.KSP
        With its matrix (``setOperators``).
    levels : PetscLevels, Hierarchy or sequence of (parts,) int
        From :func:`~agglo_petsc.levels.aggregates.aggregate_levels` or
        :func:`~agglo_petsc.levels.aggregates.given_levels`; or a hierarchy for the cells of this rank, or
        labels, one per part on this rank (with the matrix block size).
    smoother : "auto", "sweeps", "patches", "blocks" or "sor"
        ``sweeps``: agglo's sweeps through patches (through single parts without patches); ``patches``:
        PETSc's ``PCASM`` on these patches; ``blocks``: ``PCPBJACOBI`` on parts; ``sor``: ``PCSOR``; the
        last three with Chebyshev's iteration. By default ``sweeps`` if parts have a common size above one
        unknown, or there are patches; otherwise ``sor``.
    coarse_solver : "auto", "lu", "mumps", "superlu_dist" or "redundant"
        By default LU on one rank; on several ranks MUMPS if available, otherwise LU on each rank
        (``PCREDUNDANT``).
    cycle : "V" or "W"
    petsc_options : str or mapping
        PETSc options for this solver, for example ``"-mg_levels_ksp_max_it 3"``, without its prefix.

    Raises
    ------
    OptionError
        For any other value, levels that do not fit the matrix, or an unused option.
    LinAlgError
        If the matrix proves not to be positive definite.
    """
    # 1. Check options and levels
    for name, value, choices in (
        ("smoother", smoother, SMOOTHERS),
        ("coarse_solver", coarse_solver, COARSE_SOLVERS),
        ("cycle", cycle, CYCLES),
    ):
        if value not in choices:
            raise OptionError(f"{name} must be one of {', '.join(choices)}; given {value!r}")
    A = ksp.getOperators()[0]
    levels = levels_for(A, levels)
    if levels.prolongations and levels.prolongations[0].getSize()[0] != A.getSize()[0]:
        raise OptionError(
            f"the levels are for {levels.prolongations[0].getSize()[0]} unknowns; the matrix has "
            f"{A.getSize()[0]}"
        )
    # 2. Configure the levels
    smoother_name = choose_smoother(levels) if smoother == "auto" else smoother
    user_options, defaults = (
        parse_options(petsc_options),
        _coarse(A.getComm(), coarse_solver, bool(levels.prolongations)),
    )
    if levels.prolongations:
        defaults |= {"pc_mg_galerkin": "both", **_BY_SMOOTHER[smoother_name]}
        _levels_of(ksp.getPC(), levels, smoother_name, cycle)
    # 3. Set up with the options in the database
    with OptionDatabase(ksp.getOptionsPrefix() or "", defaults, user_options) as database:
        ksp.setFromOptions()
        _set_up(ksp)
        database.require_used()


def pc(
    mat: Any,
    levels: Levels,
    *,
    smoother: Smoother = "auto",
    coarse_solver: CoarseSolver = "auto",
    cycle: Cycle = "V",
    petsc_options: str | Mapping[str, Any] = "",
) -> Any:
    """Return a multigrid preconditioner (``PC``) on given levels, set up for a matrix.

    Parameters and errors are documented in :func:`setup`.
    """
    ksp = petsc().KSP().create(mat.getComm())
    ksp.setOperators(mat)
    ksp.setType("preonly")
    how: Any = {"smoother": smoother, "coarse_solver": coarse_solver, "cycle": cycle}
    setup(ksp, levels, **how, petsc_options=petsc_options)
    return ksp.getPC()


def _set_up(ksp: Any) -> None:
    """Set up a ``KSP``, and raise LinAlgError if PETSc cannot, as for a singular matrix."""
    PETSc, failure = petsc(), None
    try:
        ksp.setUp()
        ksp.setUpOnBlocks()
    except PETSc.Error as error:
        failure = error.__cause__  # exception from a callback
        if failure is None or isinstance(failure, OptionError):
            raise np.linalg.LinAlgError(f"PETSc cannot set up the levels: {failure or error}") from error
    if failure is not None:
        raise failure
    if ksp.getPC().getFailedReason():
        raise np.linalg.LinAlgError(
            "PETSc cannot factorise the matrix of a level: it is singular or nearly singular"
        )


def choose_smoother(levels: PetscLevels) -> str:
    """Return the smoother for ``auto``: patch sweeps if useful and possible on all levels, otherwise SOR."""
    if any(width is None for width in levels.widths):
        return "sor"
    several = any(width != 1 for width in levels.widths)
    return "sweeps" if several or any(each is not None for each in levels.patches) else "sor"


def _coarse(comm: Any, solver: CoarseSolver, levels: bool) -> dict[str, str]:
    """Return the PETSc options for the solver on the coarsest level, which may be the only level."""
    PETSc, prefix = petsc(), "mg_coarse_" if levels else ""
    several = comm.getSize() > 1
    if solver == "auto":
        solver = "lu" if not several else ("mumps" if PETSc.Sys.hasExternalPackage("mumps") else "redundant")
    if solver in ("mumps", "superlu_dist") and not PETSc.Sys.hasExternalPackage(solver):
        raise OptionError(
            f"coarse_solver {solver!r} is not available in this PETSc; use 'auto' or 'redundant'"
        )
    options = {} if levels else {"pc_type": "lu"}
    if solver == "redundant" or (solver == "lu" and several):
        return {**options, f"{prefix}pc_type": "redundant", f"{prefix}redundant_pc_type": "lu"}
    options |= {f"{prefix}ksp_type": "preonly"} if levels else {}
    options[f"{prefix}pc_type"] = "lu"
    return options if solver == "lu" else options | {f"{prefix}pc_factor_mat_solver_type": solver}


def _levels_of(pc: Any, levels: PetscLevels, smoother: str, cycle: Cycle) -> None:
    """Set prolongations and smoothers of all levels in a ``PC``."""
    PETSc, count = petsc(), len(levels.prolongations)
    pc.setType("mg")
    pc.setMGLevels(count + 1)
    pc.setMGCycleType(PETSc.PC.MGCycleType.V if cycle == "V" else PETSc.PC.MGCycleType.W)
    # 1. Prolongation of each level
    for at, P in enumerate(levels.prolongations):
        pc.setMGInterpolation(count - at, P)
        width, patches = levels.widths[at], levels.patches[at]
        # 2. Sweeps, forwards before and backwards after the coarse correction
        if smoother == "sweeps":
            sweeps = LevelSweeps(patches, require_width(width, smoother))
            smoothers = (pc.getMGSmootherDown(count - at), pc.getMGSmootherUp(count - at))
            for ksp, backwards in zip(smoothers, (False, True), strict=True):
                ksp.getPC().setType("python")
                ksp.getPC().setPythonContext(PatchSweeps(sweeps, backwards=backwards))
        # 3. PETSc's overlapping Schwarz on the patches
        elif smoother == "patches":
            if patches is None:
                raise OptionError(
                    f"smoother 'patches' needs patches, but level {at} has none; use 'sweeps' or 'sor'"
                )
            smooth = pc.getMGSmoother(count - at).getPC()
            smooth.setType("asm")
            groups = _index_sets(patches, require_width(width, smoother))
            smooth.setASMLocalSubdomains(len(groups), groups)


def _index_sets(patches: Patches, width: int) -> list[Any]:
    """Return the unknowns of each patch as a PETSc index set, empty for an empty patch."""
    PETSc = petsc()
    group = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
    parts = np.asarray(patches.parts)[np.lexsort((patches.parts, group))].astype(PETSc.IntType)
    each = np.split(parts, patches.offsets[1:-1])
    return [PETSc.IS().createBlock(width, one, comm=PETSc.COMM_SELF) for one in each]
