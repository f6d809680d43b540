"""Report on multigrid levels in a PETSc ``KSP``: matrices, sizes, memory."""

from __future__ import annotations

from typing import Any

from agglo_petsc.matrices import petsc, to_scipy
from agglo_petsc.ranks.patch_sweeps import PatchSweeps


def level_matrices(ksp: Any) -> list[tuple[Any, Any]]:
    """Return matrix and prolongation ``(A, P)`` per level in scipy's format, finest first, on one rank.

    P is None on the coarsest level.
    """
    matrices = []
    for A, P in _levels(ksp):
        matrices.append((to_scipy(A), None if P is None else to_scipy(P)))
    return matrices


def level_sizes(ksp: Any) -> list[tuple[int, int]]:
    """Return the numbers of unknowns and stored matrix entries per level, finest first. Collective."""
    return [(A.getSize()[0], int(A.getInfo(A.InfoType.GLOBAL_SUM)["nz_used"])) for A, _ in _levels(ksp)]


def memory_of(ksp: Any) -> int:
    """Return the memory of matrices, prolongations and factors on all levels, in bytes. Collective.

    The finest matrix is included. Factors from other packages, for example MUMPS, are included as far as
    PETSc reports them.
    """
    own = sum(_bytes(A) + _bytes(P) for A, P in _levels(ksp))
    own += sum(_bytes_of_smoother(smoother.getPC()) for smoother in _smoothers(ksp))
    return int(ksp.getComm().tompi4py().allreduce(own))


def _levels(ksp: Any) -> list[tuple[Any, Any]]:
    pc = ksp.getPC()
    if pc.getType() != "mg":
        return [(ksp.getOperators()[0], None)]
    top = pc.getMGLevels() - 1
    return [
        (pc.getMGSmoother(level).getOperators()[0], pc.getMGInterpolation(level) if level else None)
        for level in range(top, -1, -1)
    ]


def _smoothers(ksp: Any) -> list[Any]:
    pc = ksp.getPC()
    return [pc.getMGSmoother(k) for k in range(pc.getMGLevels())] if pc.getType() == "mg" else [ksp]


def _bytes(mat: Any) -> float:
    """Return the memory of the values and indices in this rank's matrix rows, in bytes.

    PETSc reports memory itself only in debug builds.
    """
    if mat is None:
        return 0.0
    index = petsc().IntType().itemsize
    entries, rows = mat.getInfo(mat.InfoType.LOCAL)["nz_used"], mat.getLocalSize()[0]
    return float(entries * (8 + index) + (rows + 1) * index)


def _bytes_of_smoother(pc: Any) -> float:
    kind = pc.getType()
    if kind == "asm":
        return sum(_bytes(each.getPC().getFactorMatrix()) for each in pc.getASMSubKSP())
    if kind in ("lu", "cholesky"):
        return _bytes(pc.getFactorMatrix())
    context = pc.getPythonContext() if kind == "python" else None
    return float(context.level.memory) if isinstance(context, PatchSweeps) else 0.0
