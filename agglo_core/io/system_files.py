"""Linear systems in files: ``.npz``, or MatrixMarket for other programs; nothing is lost but the mesh.

An ``.npz`` holds the arrays ``data, indices, indptr`` of A in CSR, ``b``, ``block_offsets`` and, if there is
one, ``near_null``. MatrixMarket has no place for several matrices: ``name.mtx`` is A, ``name_b.mtx`` b,
``name_block_offsets.mtx`` and ``name_near_null.mtx`` the others; b of one column is read as ``(n,)``. Files
appear whole or not at all.
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
from agglo_core.io.archive import Archive
from agglo_core.io.atomic import staging
from agglo_core.mesh import Mesh
from agglo_core.problems import System

__all__ = ["read_system", "write_system"]

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


def read_system(path: str | PathLike[str], mesh: Mesh | None = None) -> System:
    """The system of a file that :func:`write_system` wrote, or of a matrix with a right-hand side beside it.

    Parameters
    ----------
    mesh : Mesh, optional
        Whose cells the blocks are.

    Raises
    ------
    FileError
        For another suffix; if a file is missing or corrupt.
    OptionError
        If the arrays make no system, see :class:`~agglo_core.problems.System`.

    Examples
    --------
    >>> from agglo_core.authoring import System, read_system, write_system
    >>> A = sparse.csr_array(np.diag([2.0, 4.0]))
    >>> write_system("two.npz", System(A, np.ones(2)))
    >>> read_system("two.npz").A.toarray()
    array([[2., 0.],
           [0., 4.]])
    """
    source = Path(path)
    read = _chosen(source, {".npz": _read_npz, ".mtx": _read_market})
    try:
        found = read(source)
    except OSError as error:
        raise FileError(f"{source}: {error.strerror or error}") from error
    except FileError as error:
        raise FileError(f"{source}: {error}") from error
    return System(found["A"], found["b"], found.get("block_offsets"), mesh, found.get("near_null"))


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


def _read_npz(path: Path) -> dict[str, Any]:
    arrays = Archive(path)
    indptr = arrays.take("indptr", "iu", (None,))
    indices, data = (arrays.take(name, kind, (None,)) for name, kind in (("indices", "iu"), ("data", "f")))
    n = len(indptr) - 1
    try:
        A = sparse.csr_array((data, indices, indptr), shape=(n, n))
        A.check_format(full_check=True)
    except ValueError as error:
        raise FileError(f"arrays of A are corrupt: {error}") from None
    shape = (n, None) if "b" in arrays.members and _is_table(arrays) else (n,)
    found = {"A": A, "b": arrays.take("b", "f", shape)}
    if "block_offsets" in arrays.members:
        found["block_offsets"] = arrays.take("block_offsets", "iu", (None,))
    if "near_null" in arrays.members:
        found["near_null"] = arrays.take("near_null", "f", (n, None))
    return found


def _is_table(arrays: Archive) -> bool:
    """Whether b has two dimensions."""
    try:
        arrays.take("b", "f", (None,))
    except FileError:
        return True
    return False


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


def _read_market(path: Path) -> dict[str, Any]:
    found = {"A": sparse.csr_array(_market(path))}
    for name in _BESIDE:
        file = _beside(path, name)
        if name == "b" or file.exists():
            values = _market(file)
            values = values.toarray() if sparse.issparse(values) else np.asarray(values)
            single = name == "block_offsets" or (name == "b" and values.shape[1] == 1)
            found[name] = values[:, 0] if single else values
    return found


def _market(path: Path) -> Any:
    from scipy.io import mmread

    if not path.is_file():
        raise FileError(f"{path.name}: no such file")
    try:
        return mmread(path)
    except (ValueError, TypeError, OverflowError, EOFError) as error:
        raise FileError(f"{path.name} cannot be read: {error}") from error
