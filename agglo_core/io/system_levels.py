"""A linear system and the levels that go with it, handed over to other programs as files.

Beside the arrays of :mod:`agglo_core.io.system_files` an ``.npz`` holds ``level_0``, ``level_1``, …, the part
of each cell, finest first, and what ``scipy.sparse.load_npz`` needs to read A. MatrixMarket has files for
them: ``name_level_0.mtx``, ….
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from agglo_core.arrays import Int
from agglo_core.errors import FileError
from agglo_core.io.atomic import check_replaceable, staging
from agglo_core.io.system_files import write_system
from agglo_core.problems import System

_SUFFIXES = (".npz", ".mtx")


def check_system_file(path: Path) -> None:
    """Raise FileError unless a system can be written there, as far as can be told in advance."""
    if path.suffix.lower() not in _SUFFIXES:
        raise FileError(f"{path}: a system is written as {' or '.join(_SUFFIXES)}")
    if not path.parent.is_dir():
        raise FileError(f"{path}: there is no folder {path.parent}")
    check_replaceable(path)


def write_system_and_levels(path: str | PathLike[str], system: System, levels: Sequence[Int]) -> None:
    """Write a system, and the labels ``(n_cells,)`` of each level, to ``.npz`` or ``.mtx`` files.

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
    labels = {f"level_{k}": np.asarray(each) for k, each in enumerate(levels)}
    append = _append_npz if target.suffix.lower() == ".npz" else _append_market
    try:
        with staging(target) as folder:
            write_system(folder / target.name, system)
            append(folder / target.name, labels, system.A.shape)
    except OSError as error:
        raise FileError(f"{target}: {error.strerror or error}") from error


def _append_npz(path: Path, labels: Mapping[str, Any], shape: tuple[int, int]) -> None:
    more = {"format": np.array(b"csr"), "shape": np.array(shape), **labels}
    with ZipFile(path, "a", ZIP_DEFLATED) as archive:
        for name in sorted(more.keys() - {Path(each).stem for each in archive.namelist()}):
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, more[name], allow_pickle=False)


def _append_market(path: Path, labels: Mapping[str, Any], shape: tuple[int, int]) -> None:
    from scipy.io import mmwrite

    for name, values in labels.items():
        with path.with_name(f"{path.stem}_{name}{path.suffix}").open("wb") as stream:
            mmwrite(stream, values[:, None], symmetry="general")
