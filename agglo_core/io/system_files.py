"""Linear systems in files: ``.npz``, or MatrixMarket for other programs; nothing is lost but the mesh.

An ``.npz`` holds the arrays ``data, indices, indptr`` of A in CSR, ``b``, ``block_offsets`` and, if there is
one, ``near_null``. MatrixMarket has no place for several matrices: ``name.mtx`` is A, ``name_b.mtx`` b,
``name_block_offsets.mtx`` and ``name_near_null.mtx`` the others. Files appear whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.errors import FileError
from agglo_core.io.atomic import staging
from agglo_core.problems import System

__all__ = ["write_system"]

_BESIDE = ("b", "block_offsets", "near_null")
_DIGITS = 17
"""That tell one float64 from any other."""


def write_system(path: str | PathLike[str], system: System) -> None:
    """Write a system to ``.npz``, or to ``.mtx`` and files beside it.

    Raises
    ------
    FileError
        For another suffix, or if a file cannot be written.

    Examples
    --------
    >>> write_system("poisson.mtx", system)  # doctest: +SKIP
    """
    target = Path(path)
    write = _chosen(target, {".npz": _write_npz, ".mtx": _write_market})
    try:
        with staging(target) as folder:
            write(folder / target.name, system)
    except OSError as error:
        raise FileError(f"{target}: {error.strerror or error}") from error


def _chosen(path: Path, by_suffix: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    if path.suffix.lower() not in by_suffix:
        raise FileError(f"{path}: a system is read and written as {', '.join(by_suffix)}")
    return by_suffix[path.suffix.lower()]


def _arrays(system: System) -> dict[str, NDArray[Any]]:
    found = {name: getattr(system, name) for name in _BESIDE}
    return {name: values for name, values in found.items() if values is not None}


def _write_npz(path: Path, system: System) -> None:
    A = sparse.csr_array(system.A)
    arrays: dict[str, Any] = {"data": A.data, "indices": A.indices, "indptr": A.indptr, **_arrays(system)}
    with path.open("wb") as stream:  # by name numpy would add a suffix to .NPZ
        np.savez_compressed(stream, **arrays)


def _beside(path: Path, name: str) -> Path:
    return path.with_name(f"{path.stem}_{name}{path.suffix}")


def _write_market(path: Path, system: System) -> None:
    from scipy.io import mmwrite

    matrices = {path: sparse.coo_array(system.A)}
    for name, values in _arrays(system).items():
        matrices[_beside(path, name)] = values if values.ndim == 2 else values[:, None]
    for target, matrix in matrices.items():
        with target.open("wb") as stream:
            mmwrite(stream, matrix, precision=_DIGITS, symmetry="general")
