"""Read and write linear systems (without the mesh) losslessly, as ``.npz`` or MatrixMarket files.

An ``.npz`` holds the CSR arrays ``data, indices, indptr`` of A, ``b``, ``block_offsets`` and, if present,
``near_null``. MatrixMarket files hold one matrix each: ``name.mtx`` is A, ``name_b.mtx`` is b,
``name_block_offsets.mtx`` and ``name_near_null.mtx`` are the others; b with one column is read as ``(n,)``.
Files appear whole or not at all.

Levels of a system are the arrays ``level_0``, ``level_1``, … in an ``.npz`` (agglomerate per cell, finest
level first), together with the entries for ``scipy.sparse.load_npz``; or files ``name_level_0.mtx``, ….
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import Int
from agglo_core.errors import FileError, OptionError
from agglo_core.files.archive import REAL
from agglo_core.files.matrix_market import read_matrix_market
from agglo_core.files.stored_matrices import matrix_archive, read_matrix, read_vectors, stored_matrix
from agglo_core.io.atomic import check_replaceable, staging
from agglo_core.mesh import Mesh
from agglo_core.problems import System
from agglo_core.problems.real_arrays import real_matrix

_BESIDE = ("b", "block_offsets", "near_null")
_DIGITS = 17
"""Decimal digits that identify a float64."""


def write_system(path: str | PathLike[str], system: System) -> None:
    """Write a linear system to an ``.npz`` file, or to an ``.mtx`` file and files beside it.

    Raises
    ------
    FileError
        For another suffix, or if a file cannot be written.

    Examples
    --------
    >>> write_system("poisson.mtx", system)  # doctest: +SKIP
    """
    target = Path(path)
    write = _choose_by_suffix(target, {".npz": _write_npz, ".mtx": _write_market})
    try:
        with staging(target) as folder:
            write(folder / target.name, system)
    except OSError as error:
        raise FileError(f"{target}: {error.strerror or error}") from error


def read_system(path: str | PathLike[str], mesh: Mesh | None = None) -> System:
    """Read a linear system written by :func:`write_system`, or a matrix and its right-hand side.

    Parameters
    ----------
    mesh : Mesh, optional
        Mesh whose cells are the blocks.

    Raises
    ------
    FileError
        For another suffix, or if a file is missing or corrupt.
    OptionError
        With the file name, if the arrays form no valid :class:`~agglo_core.problems.System`.

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
    read = _choose_by_suffix(source, {".npz": _read_npz, ".mtx": _read_market})
    with _name_in_errors(source):
        _require_file(source)
        arrays = read(source)
        A = real_matrix(arrays["A"])
    try:
        return System(A, arrays["b"], arrays.get("block_offsets"), mesh, arrays.get("near_null"))
    except OptionError as error:
        raise OptionError(f"{source}: {error}") from error


def _choose_by_suffix(path: Path, by_suffix: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    if path.suffix.lower() not in by_suffix:
        raise FileError(f"{path}: the suffix of a system file must be one of {', '.join(by_suffix)}")
    return by_suffix[path.suffix.lower()]


def _arrays(system: System) -> dict[str, NDArray[Any]]:
    arrays = {name: getattr(system, name) for name in _BESIDE}
    return {name: values for name, values in arrays.items() if values is not None}


def _write_npz(path: Path, system: System) -> None:
    A = sparse.csr_array(system.A)
    arrays: dict[str, Any] = {"data": A.data, "indices": A.indices, "indptr": A.indptr, **_arrays(system)}
    with path.open("wb") as stream:  # numpy would add a suffix to the name .NPZ
        np.savez_compressed(stream, **arrays)


def _read_npz(path: Path) -> dict[str, Any]:
    A = stored_matrix(matrix_archive(path))
    archive = matrix_archive(path, A.shape[0])
    arrays = {"A": A, "b": archive.take("b", REAL, None)}
    if "block_offsets" in archive.members:
        arrays["block_offsets"] = archive.integers("block_offsets", (None,))
    if "near_null" in archive.members:
        arrays["near_null"] = archive.take("near_null", REAL, (A.shape[0], None))
    return arrays


def _companion_path(path: Path, name: str) -> Path:
    return path.with_name(f"{path.stem}_{name}{path.suffix}")


def _write_market(path: Path, system: System) -> None:
    from scipy.io import mmwrite

    matrices = {path: sparse.coo_array(system.A)}
    for name, values in _arrays(system).items():
        matrices[_companion_path(path, name)] = values if values.ndim == 2 else values[:, None]
    for target, matrix in matrices.items():
        with target.open("wb") as stream:
            mmwrite(stream, matrix, precision=_DIGITS, symmetry="general")


def _read_market(path: Path) -> dict[str, Any]:
    A = read_matrix(path)
    arrays = {"A": A}
    for name in _BESIDE:
        file = _companion_path(path, name)
        if name == "b" or file.exists():
            with _name_in_errors(file.name):
                _require_file(file)
                arrays[name] = (
                    _offsets(file) if name == "block_offsets" else read_vectors(file, name, A.shape[0])
                )
    if arrays["b"].shape[1] == 1:
        arrays["b"] = arrays["b"][:, 0]
    return arrays


def _offsets(path: Path) -> NDArray[Any]:
    values = read_matrix_market(path)
    if isinstance(values, np.ndarray) and values.shape[1] == 1:
        return values[:, 0]
    raise FileError("expected an array with one column")


def _require_file(path: Path) -> None:
    if not path.is_file():
        raise FileError("is not a regular file" if path.exists() else "no such file")


@contextmanager
def _name_in_errors(name: object) -> Iterator[None]:
    """Prefix the file name to the message of any error raised in the ``with`` block."""
    try:
        yield
    except (FileError, OptionError) as error:
        raise FileError(f"{name}: {error}") from error.__cause__
    except OSError as error:
        raise FileError(f"{name}: {error.strerror or error}") from error
    except MemoryError as error:
        raise FileError(f"{name}: not enough memory to read it") from error


_SUFFIXES = (".npz", ".mtx")


def check_system_file(path: Path) -> None:
    """Raise FileError if writing a linear system to this path would certainly fail."""
    if path.suffix.lower() not in _SUFFIXES:
        raise FileError(f"{path}: the suffix of a system file must be {' or '.join(_SUFFIXES)}")
    if not path.parent.is_dir():
        raise FileError(f"{path}: the folder {path.parent} does not exist")
    check_replaceable(path)


def write_system_and_levels(path: str | PathLike[str], system: System, levels: Sequence[Int]) -> None:
    """Write a linear system and the labels ``(n_cells,)`` of each level to ``.npz`` or ``.mtx`` files.

    Raises
    ------
    FileError
        For another suffix, or if a file cannot be written.

    Examples
    --------
    >>> write_system_and_levels("poisson.npz", system, hierarchy.levels)  # doctest: +SKIP
    """
    target = Path(path)
    check_system_file(target)
    labels = {f"level_{k}": np.asarray(level) for k, level in enumerate(levels)}
    append = _append_npz if target.suffix.lower() == ".npz" else _append_market
    try:
        with staging(target) as folder:
            write_system(folder / target.name, system)
            append(folder / target.name, labels, system.A.shape)
    except OSError as error:
        raise FileError(f"{target}: {error.strerror or error}") from error


def _append_npz(path: Path, labels: Mapping[str, Any], shape: tuple[int, int]) -> None:
    arrays = {"format": np.array(b"csr"), "shape": np.array(shape), **labels}
    with ZipFile(path, "a", ZIP_DEFLATED) as archive:
        for name in sorted(arrays.keys() - {Path(file).stem for file in archive.namelist()}):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, arrays[name], allow_pickle=False)


def _append_market(path: Path, labels: Mapping[str, Any], shape: tuple[int, int]) -> None:
    from scipy.io import mmwrite

    for name, values in labels.items():
        with path.with_name(f"{path.stem}_{name}{path.suffix}").open("wb") as stream:
            mmwrite(stream, values[:, None], symmetry="general")
