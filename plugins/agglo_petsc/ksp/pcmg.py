"""PETSc's multigrid ``PCMG`` on our levels, for any ``KSP``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from agglo_core.authoring import OptionError, Patches
from agglo_petsc.ksp.option_database import OptionDatabase, parsed_options
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
    """Make multigrid on our levels the preconditioner of a user's ``KSP``, and set both up; collective.

    Coarse matrices are Galerkin products, made anew by PETSc when the matrix changes. Everything else of the
    ``KSP``, its type and tolerances, stays as it is. Options in PETSc's database under the prefix of the
    ``KSP`` count more than our defaults.

    Parameters
    ----------
    ksp : petsc4py.PETSc.KSP
        With its matrix (``setOperators``).
    levels : PetscLevels, Hierarchy or sequence of (parts,) int
        Of :func:`~agglo_petsc.levels.aggregates.aggregate_levels` or
        :func:`~agglo_petsc.levels.aggregates.given_levels`; or a hierarchy of what this rank has, or labels,
        one for each of its parts (of the block size of the matrix).
    smoother : "auto", "sweeps", "patches", "blocks" or "sor"
        Our sweeps through patches (through single parts where there are none); PETSc's ``PCASM`` on the same
        patches, ``PCPBJACOBI`` on parts, ``PCSOR``, these three under Chebyshev's iteration. By default
        sweeps where parts are of one size and more than one unknown, or there are patches; else sor.
    coarse_solver : "auto", "lu", "mumps", "superlu_dist" or "redundant"
        By default LU on one rank; on several MUMPS if there is one, or LU on each rank (``PCREDUNDANT``).
    cycle : "V" or "W"
    petsc_options : str or mapping
        Options of PETSc for this solver, such as ``"-mg_levels_ksp_max_it 3"``, without its prefix.

    Raises
    ------
    OptionError
        For any other value, levels that do not fit the matrix, an option that nothing uses.
    LinAlgError
        If the matrix is found not to be positive definite.
    """
    for name, value, known in (
        ("smoother", smoother, SMOOTHERS),
        ("coarse_solver", coarse_solver, COARSE_SOLVERS),
        ("cycle", cycle, CYCLES),
    ):
        if value not in known:
            raise OptionError(f"{name} must be one of {', '.join(known)}; given {value!r}")
    A = ksp.getOperators()[0]
    levels = levels_for(A, levels)
    if levels.prolongations and levels.prolongations[0].getSize()[0] != A.getSize()[0]:
        raise OptionError(
            f"the levels are for {levels.prolongations[0].getSize()[0]} unknowns; the matrix has "
            f"{A.getSize()[0]}"
        )
    chosen = chosen_smoother(levels) if smoother == "auto" else smoother
    given, defaults = (
        parsed_options(petsc_options),
        _coarse(A.getComm(), coarse_solver, bool(levels.prolongations)),
    )
    if levels.prolongations:
        defaults |= {"pc_mg_galerkin": "both", **_BY_SMOOTHER[chosen]}
        _levels_of(ksp.getPC(), levels, chosen, cycle)
    with OptionDatabase(ksp.getOptionsPrefix() or "", defaults, given) as database:
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
    """A ``PC`` on the levels, set up for a matrix; parameters and errors are those of :func:`setup`."""
    ksp = petsc().KSP().create(mat.getComm())
    ksp.setOperators(mat)
    ksp.setType("preonly")
    how: Any = {"smoother": smoother, "coarse_solver": coarse_solver, "cycle": cycle}
    setup(ksp, levels, **how, petsc_options=petsc_options)
    return ksp.getPC()


def _set_up(ksp: Any) -> None:
    """Set a solver up; what PETSc finds wrong with the matrix is a LinAlgError."""
    PETSc, failure = petsc(), None
    try:
        ksp.setUp()
        ksp.setUpOnBlocks()
    except PETSc.Error as error:
        failure = error.__cause__  # what a callback raised
        if failure is None or isinstance(failure, OptionError):
            raise np.linalg.LinAlgError(f"PETSc cannot set up the levels: {failure or error}") from error
    if failure is not None:
        raise failure
    if ksp.getPC().getFailedReason():
        raise np.linalg.LinAlgError(
            "PETSc cannot factorise a matrix of the levels: it is singular, or nearly so"
        )


def chosen_smoother(levels: PetscLevels) -> str:
    """What ``auto`` is: sweeps, where they are of use and can be had on all levels, else SOR."""
    if any(width is None for width in levels.widths):
        return "sor"
    several = any(width != 1 for width in levels.widths)
    return "sweeps" if several or any(each is not None for each in levels.patches) else "sor"


def _coarse(comm: Any, asked: CoarseSolver, levels: bool) -> dict[str, str]:
    """Options of the solver on the coarsest level, which is the matrix itself without others."""
    PETSc, prefix = petsc(), "mg_coarse_" if levels else ""
    several = comm.getSize() > 1
    if asked == "auto":
        asked = "lu" if not several else ("mumps" if PETSc.Sys.hasExternalPackage("mumps") else "redundant")
    if asked in ("mumps", "superlu_dist") and not PETSc.Sys.hasExternalPackage(asked):
        raise OptionError(f"coarse_solver {asked!r} is not in this PETSc; take 'auto' or 'redundant'")
    found = {} if levels else {"pc_type": "lu"}
    if asked == "redundant" or (asked == "lu" and several):
        return {**found, f"{prefix}pc_type": "redundant", f"{prefix}redundant_pc_type": "lu"}
    found |= {f"{prefix}ksp_type": "preonly"} if levels else {}
    found[f"{prefix}pc_type"] = "lu"
    return found if asked == "lu" else found | {f"{prefix}pc_factor_mat_solver_type": asked}


def _levels_of(pc: Any, levels: PetscLevels, smoother: str, cycle: Cycle) -> None:
    """Give a ``PC`` its levels, PETSc's numbers of which count from the coarsest."""
    PETSc, count = petsc(), len(levels.prolongations)
    pc.setType("mg")
    pc.setMGLevels(count + 1)
    pc.setMGCycleType(PETSc.PC.MGCycleType.V if cycle == "V" else PETSc.PC.MGCycleType.W)
    for at, P in enumerate(levels.prolongations):
        pc.setMGInterpolation(count - at, P)
        width, patches = levels.widths[at], levels.patches[at]
        if smoother == "sweeps":
            sweeps = LevelSweeps(patches, require_width(width, smoother))
            smoothers = (pc.getMGSmootherDown(count - at), pc.getMGSmootherUp(count - at))
            for ksp, backwards in zip(smoothers, (False, True), strict=True):
                ksp.getPC().setType("python")
                ksp.getPC().setPythonContext(PatchSweeps(sweeps, backwards=backwards))
        elif smoother == "patches":
            if patches is None:
                raise OptionError(
                    f"smoother 'patches' needs the patches of level {at}; take 'sweeps' or 'sor'"
                )
            smooth = pc.getMGSmoother(count - at).getPC()
            smooth.setType("asm")
            groups = _index_sets(patches, require_width(width, smoother))
            smooth.setASMLocalSubdomains(len(groups), groups)


def _index_sets(patches: Patches, width: int) -> list[Any]:
    """The unknowns of each patch, as PETSc wants them: a set for each, and an empty one rather than none."""
    PETSc = petsc()
    group = np.repeat(np.arange(len(patches)), np.diff(patches.offsets))
    parts = np.asarray(patches.parts)[np.lexsort((patches.parts, group))].astype(PETSc.IntType)
    each = np.split(parts, patches.offsets[1:-1])
    return [PETSc.IS().createBlock(width, one, comm=PETSc.COMM_SELF) for one in each]
