"""Sparse direct solvers of symmetric matrices, by name: each makes a solve from a matrix.

A solve maps right-hand sides, ``(n,)`` or ``(n, k)``, to solutions of the same shape; the factors live as
long as it does.
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

from agglo_core import multigrid
from agglo_core.errors import OptionError

_log = logging.getLogger("agglo")

AUTO: Final = "auto"
"""The first of PARDISO, CHOLMOD and SuperLU that is installed."""
Solves = Callable[[Any], Any]
"""Maps right-hand sides ``(n,)`` or ``(n, k)`` to solutions."""

_CHOLESKY, _BUNCH_KAUFMAN = 2, -2  # types of symmetric matrices as PARDISO numbers them


def superlu(A: Any) -> Solves:
    """SuperLU, which is part of scipy, with pivots on the diagonal wherever they will do.

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
    """PARDISO of Intel's MKL, by ``pypardiso``: Cholesky, or Bunch–Kaufman if a pivot is not positive.

    Raises
    ------
    OptionError
        If pypardiso is not installed.
    LinAlgError
        If the factorisation fails.
    """
    package = _package("pardiso")
    upper = sparse.csr_matrix(sparse.triu(A, format="csr"), dtype=np.float64)
    upper.setdiag(sparse.csr_array(A).diagonal())  # PARDISO wants the zeros of a diagonal stored
    upper.sort_indices()
    for kind in (_CHOLESKY, _BUNCH_KAUFMAN):
        with _path_of_mkl():
            solver = package.PyPardisoSolver(mtype=kind)
        try:
            solver.factorize(upper)
        except (ValueError, package.PyPardisoError) as error:  # only the second kind takes pivots below 0
            failure = error
            solver.free_memory(everything=True)
            continue

        def solve(b: Any, solver: Any = solver) -> Any:
            return solver.solve(upper, np.asfortranarray(b, dtype=np.float64))

        weakref.finalize(solve, solver.free_memory, everything=True)  # MKL's memory is nobody else's to free
        return solve
    raise np.linalg.LinAlgError(f"PARDISO: {failure}")


def cholmod(A: Any) -> Solves:
    """CHOLMOD of SuiteSparse, by ``scikit-sparse``, for positive definite matrices.

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


BACKENDS: Final[Mapping[str, Callable[[Any], Solves]]] = MappingProxyType(
    {"pardiso": pardiso, "cholmod": cholmod, "superlu": superlu}
)
"""The direct solvers by name, the fastest first."""

PACKAGES: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {"pardiso": ("pypardiso.pardiso_wrapper", "pypardiso"), "cholmod": ("sksparse.cholmod", "scikit-sparse")}
)
"""The module that each needs, and what pip calls it."""


def chosen_backend(name: str) -> str:
    """The name of an installed solver: that given, or the first one for ``"auto"``.

    Raises
    ------
    OptionError
        For another name, or a solver that is not installed; says what to install.
    """
    if name == AUTO:
        return available_backends()[0]
    if name not in BACKENDS:
        raise OptionError(f"backend must be one of {', '.join((AUTO, *BACKENDS))}; given {name!r}")
    if name in PACKAGES:
        _package(name)
    return name


def available_backends() -> tuple[str, ...]:
    """Names of the solvers that are installed, the fastest first."""
    return tuple(each for each in BACKENDS if _installed(each))


def _installed(name: str) -> bool:
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
    """Set the variable by which pypardiso finds MKL, unless it is set or pip did not install MKL.

    Without it pypardiso searches the whole environment, once on import and once for each solver. That takes
    a third of a second, far longer than the factorisation of a small matrix.
    """
    variable, path = "PYPARDISO_MKL_RT", _installed_mkl()
    if path is None or variable in os.environ:
        yield
        return
    os.environ[variable] = path
    try:
        yield
    finally:
        os.environ.pop(variable, None)  # another thread may have removed it


@cache
def _installed_mkl() -> str | None:
    """Path of MKL's runtime library, from the list of files of the distribution ``mkl``."""
    try:
        files = metadata.files("mkl") or []
    except metadata.PackageNotFoundError:
        return None
    names = sorted((str(file.locate()) for file in files if "mkl_rt" in file.name), key=len)
    return names[0] if names else None
