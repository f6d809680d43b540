"""Names of the arrays in VTKHDF files, and safe reading of one partition."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import FileError

GROUP = "VTKHDF"
DERIVED = "agglo"
"""Attribute of datasets derived from the mesh or its hierarchy."""

NAMES = {
    **{"connectivity": "Connectivity", "offsets": "Offsets", "types": "Types"},
    **{"face_connectivity": "FaceConnectivity", "face_offsets": "FaceOffsets"},
    **{"polyhedron_to_faces": "PolyhedronToFaces", "polyhedron_offsets": "PolyhedronOffsets"},
}
"""VTKHDF names of arrays by their VTU names; in VTKHDF, offsets begin with 0."""

COUNTS = {
    **{"connectivity": "NumberOfConnectivityIds", "face_connectivity": "NumberOfFaceConnectivityIds"},
    **{"face_offsets": "NumberOfFaces", "polyhedron_to_faces": "NumberOfPolyhedronToFaceIds"},
}
"""Datasets with the lengths of arrays that are not per cell."""


def hdf5() -> Any:
    """Import and return the module h5py.

    Raises
    ------
    FileError
        If it is not installed.
    """
    try:
        import h5py
    except ImportError as error:
        raise FileError(f"VTKHDF needs h5py: pip install agglo[hdf] ({error})") from error
    return h5py


def member(group: Any, name: str) -> Any:
    """Return a numeric dataset of an HDF5 group, or None if the group does not have it.

    Raises
    ------
    FileError
        For a link to another location or file, external storage, or non-numeric data.
    """
    dataset = _follow_hard_link(group, name, "dataset")
    if dataset is None:
        return None
    if not isinstance(dataset, hdf5().Dataset) or dataset.is_virtual or dataset.external:
        raise FileError(f"{name!r} is not a dataset stored in the file itself")
    if dataset.dtype.kind not in "iuf" or dataset.shape is None:
        raise FileError(f"dataset {name!r} is not numeric")
    return dataset


def subgroup(group: Any, name: str) -> Any:
    """Return a subgroup of an HDF5 group, or None if the group does not have it.

    Raises FileError for other members.
    """
    child = _follow_hard_link(group, name, "group")
    if child is not None and not isinstance(child, hdf5().Group):
        raise FileError(f"{name!r} is not a group")
    return child


def datasets(group: Any) -> dict[str, Any]:
    """Return all datasets of an HDF5 group by name (empty if the group is None).

    Raises FileError for links.
    """
    members = {} if group is None else {name: _follow_hard_link(group, name, "dataset") for name in group}
    return {name: child for name, child in members.items() if isinstance(child, hdf5().Dataset)}


def _follow_hard_link(group: Any, name: str, kind: str) -> Any:
    """Return a member of an HDF5 group, but reject soft and external links.

    Soft and external links may lead to other files.
    """
    link = group.get(name, getlink=True)
    if link is None:
        return None
    if not isinstance(link, hdf5().HardLink):
        raise FileError(f"{name!r} is a link, expected a {kind} stored in the file itself")
    return group[name]


@dataclass(frozen=True)
class Partition:
    """One partition of a VTKHDF file: its integer arrays, under their names in VTU files."""

    group: Any
    cells: tuple[int, int]  # first and last cell in the file
    counts: Mapping[str, tuple[int, int]]  # start and end of arrays with other lengths
    place: int  # partition number; each earlier partition has one offset more than cells or faces

    def __contains__(self, name: str) -> bool:
        return name in NAMES and NAMES[name] in self.group

    def take(self, name: str, declared: int) -> Int:
        """Return the array with this name, of the declared length.

        Raises FileError if damaged.
        """
        start, stop = self.counts.get(name, self.cells)
        if NAMES[name].endswith("Offsets"):
            start, stop = start + self.place, stop + self.place + 1
        values = self._values(name, start, stop)
        if values.dtype.kind not in "iu":
            raise FileError(f"dataset {NAMES[name]!r} must hold integers, not {values.dtype}")
        if not NAMES[name].endswith("Offsets"):
            return frozen_int(values)
        if values[0] != 0:
            raise FileError(
                f"dataset {NAMES[name]!r} begins with {values[0]} in partition {self.place}, not 0"
            )
        return frozen_int(values[1:])

    def _values(self, name: str, start: int, stop: int) -> NDArray[Any]:
        dataset = member(self.group, NAMES[name])
        if dataset is None:
            raise FileError(f"dataset {NAMES[name]!r} is missing")
        if dataset.ndim != 1 or dataset.shape[0] < stop:
            raise FileError(
                f"dataset {NAMES[name]!r} has the shape {dataset.shape}, expected ({stop},) or more"
            )
        return np.asarray(dataset[start:stop])
