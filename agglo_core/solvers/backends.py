"""Sparse direct solvers by name, for symmetric and for other matrices.

A solver takes a matrix and returns a function that maps right-hand sides, ``(n,)`` or ``(n, k)``, to
solutions of equal shape. The factors live as long as this function.
"""

from __future__ import annotations

import logging
import os
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import import_module, metadata
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from agglo_core import multigrid
from agglo_core.errors import OptionError

_log = logging.getLogger("agglo")

AUTO: Final = "auto"
"""Selects the first installed solver among PARDISO, CHOLMOD and SuperLU."""
Solves = Callable[[Any], Any]
"""Maps right-hand sides ``(n,)`` or ``(n, k)`` to solutions."""

_CHOLESKY, _BUNCH_KAUFMAN, _GENERAL = 2, -2, 11  # PARDISO's codes of matrix types


def superlu(A: Any) -> Solves:
    """Factorise with SuperLU (part of scipy), with diagonal pivots wherever possible.

    Raises
    ------
    LinAlgError
        If the matrix is singular.
    """
    factors = multigrid.symmetric_lu(sparse.csc_array(A), pivots=0.001)
    if factors is None:
        raise np.linalg.LinAlgError(f"SuperLU: the matrix of {A.shape[0]} unknowns is singular")
    return lambda b: np.asarray(factors.solve(np.asarray(b, dtype=np.float64)))


def pardiso(A: Any) -> Solves:
    """Factorise with Intel's PARDISO by ``pypardiso``: Cholesky, or Bunch–Kaufman for pivots ≤ 0.

    Raises
    ------
    OptionError
        If pypardiso is not installed.
    LinAlgError
        If the factorisation fails.
    """
    package = _package("pardiso")
    upper = sparse.csr_matrix(sparse.triu(A, format="csr"), dtype=np.float64)
    upper.setdiag(sparse.csr_array(A).diagonal())  # PARDISO requires stored diagonal zeros
    upper.sort_indices()
    try:
        return _pardiso(package, upper, _CHOLESKY)
    except np.linalg.LinAlgError:  # only Bunch–Kaufman accepts pivots below 0
        return _pardiso(package, upper, _BUNCH_KAUFMAN)


def _pardiso(package: Any, matrix: Any, kind: int) -> Solves:
    """Factorise a sorted CSR matrix with PARDISO's code ``kind``, or raise LinAlgError."""
    with _path_of_mkl():
        solver = package.PyPardisoSolver(mtype=kind)
    try:
        solver.factorize(matrix)
    except (ValueError, package.PyPardisoError) as error:
        solver.free_memory(everything=True)
        raise np.linalg.LinAlgError(f"PARDISO: {error}") from error

    def solve(b: Any) -> Any:
        return solver.solve(matrix, np.asfortranarray(b, dtype=np.float64))

    weakref.finalize(solve, solver.free_memory, everything=True)  # Python does not free MKL's memory
    return solve


def cholmod(A: Any) -> Solves:
    """Factorise a positive definite matrix with SuiteSparse's CHOLMOD by ``scikit-sparse``.

    Raises
    ------
    OptionError
        If scikit-sparse is not installed.
    LinAlgError
        If the matrix is not positive definite.
    """
    package = _package("cholmod")
    matrix = sparse.csc_matrix(A, dtype=np.float64)
    matrix.sort_indices()
    try:
        if hasattr(package, "cho_factor"):  # since scikit-sparse 0.5
            solve = package.cho_factor(matrix).solve
        else:
            solve = package.cholesky(matrix)
    except package.CholmodError as error:
        raise np.linalg.LinAlgError(f"CHOLMOD: the matrix is not positive definite ({error})") from error
    return lambda b: np.asarray(solve(np.asarray(b, dtype=np.float64)))


def general_superlu(A: Any) -> Solves:
    """Factorise a matrix that need not be symmetric with SuperLU.

    Raises
    ------
    LinAlgError
        If the matrix is singular.
    """
    try:
        factors = splu(sparse.csc_array(A))
    except RuntimeError as error:
        raise np.linalg.LinAlgError(f"SuperLU: {error}") from error
    return lambda b: np.asarray(factors.solve(np.asarray(b, dtype=np.float64)))


def general_pardiso(A: Any) -> Solves:
    """Factorise a matrix that need not be symmetric with PARDISO.

    Raises
    ------
    OptionError
        If pypardiso is not installed.
    LinAlgError
        If the factorisation fails.
    """
    package = _package("pardiso")
    matrix = sparse.csr_matrix(A, dtype=np.float64)
    matrix.sort_indices()
    return _pardiso(package, matrix, _GENERAL)


BACKENDS: Final[Mapping[str, Callable[[Any], Solves]]] = MappingProxyType(
    {"pardiso": pardiso, "cholmod": cholmod, "superlu": superlu}
)
"""Direct solvers by name, fastest first."""

GENERAL_BACKENDS: Final[Mapping[str, Callable[[Any], Solves]]] = MappingProxyType(
    {"pardiso": general_pardiso, "superlu": general_superlu}
)
"""Direct solvers for matrices that need not be symmetric, fastest first."""

PACKAGES: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {"pardiso": ("pypardiso.pardiso_wrapper", "pypardiso"), "cholmod": ("sksparse.cholmod", "scikit-sparse")}
)
"""Module and pip name for each solver's package."""


def choose_backend(name: str, among: Mapping[str, Callable[[Any], Solves]] | None = None) -> str:
    """Return the name of an installed solver: the given name, or the fastest for ``"auto"``.

    ``among`` restricts the choice, for example to :data:`GENERAL_BACKENDS`.

    Raises
    ------
    OptionError
        For an unknown name, or a solver that is not installed (with the package to install).
    """
    if name == AUTO:
        return next(each for each in available_backends() if among is None or each in among)
    if name not in BACKENDS:
        raise OptionError(f"backend must be one of {', '.join((AUTO, *BACKENDS))}; given {name!r}")
    if among is not None and name not in among:
        raise OptionError(
            f"backend {name} requires a symmetric matrix, but that of the problem is not: use one of "
            f"{', '.join(among)}"
        )
    if name in PACKAGES:
        _package(name)
    return name


def available_backends() -> tuple[str, ...]:
    """Return the names of installed solvers, fastest first."""
    return tuple(each for each in BACKENDS if _is_installed(each))


def _is_installed(name: str) -> bool:
    try:
        return name not in PACKAGES or bool(_package(name))
    except OptionError as missing:
        _log.debug("%s", missing)
        return False


def _package(name: str) -> Any:
    module, distribution = PACKAGES[name]
    try:
        with _path_of_mkl():
            return import_module(module)
    except ImportError as error:
        raise OptionError(
            f"backend {name!r} needs {distribution}: pip install {distribution} ({error})"
        ) from error


@contextmanager
def _path_of_mkl() -> Iterator[None]:
    """Set the environment variable that points pypardiso to an MKL from pip, unless it is already set.

    Without the variable, pypardiso searches the whole environment on import and again for each solver. A
    search takes a third of a second, far longer than factorising a small matrix.
    """
    variable, path = "PYPARDISO_MKL_RT", _mkl_from_package()
    if path is None or variable in os.environ:
        yield
        return
    os.environ[variable] = path
    try:
        yield
    finally:
        os.environ.pop(variable, None)  # another thread may have removed it


@cache
def _mkl_from_package() -> str | None:
    """Return the path of MKL's runtime library if pip installed MKL, else None."""
    try:
        files = metadata.files("mkl") or []
    except metadata.PackageNotFoundError:
        return None
    names = sorted((str(file.locate()) for file in files if "mkl_rt" in file.name), key=len)
    return names[0] if names else None
