"""Writing VTKHDF: VTK's unstructured grids in HDF5, one partition."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, fits_in_index, frozen_int
from agglo_core.errors import FileError
from agglo_core.io.level_values import LevelValues
from agglo_core.io.vtk.cells import POLYHEDRON, Cells
from agglo_core.io.vtk.document import Piece
from agglo_core.io.vtk.grid_pieces import numbered
from agglo_core.io.vtk.grids import Storage, write_grids
from agglo_core.io.vtk.hdf_arrays import COUNTS, DERIVED, GROUP, NAMES, hdf5
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import take_cells
from agglo_core.progress import Tell, part, to_nobody

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_VERSION, _WITH_FACES = (2, 0), (2, 5)  # of the format: the first for such files, the first with polyhedra
_LEVEL = 1  # of deflate: higher ones take twice as long for a few per cent


def write_vtkhdf(
    path: Path,
    mesh: Mesh,
    hierarchy: Hierarchy | None,
    level_values: LevelValues | None = None,
    tell: Tell = to_nobody,
    *,
    compress: bool = False,
) -> None:
    """Write ``path``, and with a hierarchy each coarse mesh beside it: see :func:`write_grids`.

    Raises
    ------
    FileError
        If h5py is not installed, or for a tag whose name HDF5 cannot hold.
    """
    hdf5()
    write_grids(Storage(_write, _faces, _ours), path, mesh, hierarchy, level_values, tell, compress=compress)


def _ours(file: Path) -> bool:
    with hdf5().File(file) as found:
        stored = isinstance(found.get(GROUP, getlink=True), hdf5().HardLink)
        return stored and "agglo" in found[GROUP].attrs


def _faces(cells: Cells, number: Int | None) -> dict[str, NDArray[Any]]:
    """Faces of polyhedra one after the other, each cell its own; other cells have none."""
    own = cells.types == POLYHEDRON
    offsets, loop_offsets, vertices = take_cells(cells.solids, frozen_int(np.flatnonzero(own)))
    counts = np.zeros(len(own), np.int64)
    counts[own] = np.diff(offsets)
    return {
        "face_connectivity": numbered(vertices, number),
        "face_offsets": loop_offsets[1:],
        "polyhedron_to_faces": np.arange(len(loop_offsets) - 1),
        "polyhedron_offsets": np.cumsum(counts),
    }


def _write(path: Path, piece: Piece, *, compress: bool, tell: Tell) -> None:
    options = {"compression": "gzip", "compression_opts": _LEVEL, "shuffle": True} if compress else {}
    with hdf5().File(path, "w") as file:
        group = file.create_group(GROUP)
        group.attrs["Version"] = np.array(_WITH_FACES if "face_offsets" in piece.cells else _VERSION)
        group.attrs["Type"] = np.bytes_(b"UnstructuredGrid")
        group.attrs["agglo"] = np.bytes_(piece.kind.encode())
        arrays = list(_arrays(piece))
        for place, (name, values) in enumerate(arrays):
            part(tell, place, len(arrays), name)
            group.create_dataset(name, data=values, **(options if values.size > 1 else {}))
        for name in piece.derived:
            group[f"CellData/{name}"].attrs[DERIVED] = np.bytes_(b"derived")


def _arrays(piece: Piece) -> list[tuple[str, NDArray[Any]]]:
    points = np.zeros((len(piece.points), 3))
    points[:, : piece.points.shape[1]] = piece.points
    found: list[tuple[str, NDArray[Any]]] = [("Points", points)]
    sizes = {"NumberOfPoints": len(points), "NumberOfCells": len(piece.cells["types"])}
    for name, values in piece.cells.items():
        stored = NAMES[name]
        whole = np.concatenate(([0], values)) if stored.endswith("Offsets") else values
        found.append((stored, whole if values.dtype == np.uint8 else whole.astype(np.int64)))
        if name in COUNTS:
            sizes[COUNTS[name]] = len(values)
    found = [(name, np.array([count])) for name, count in sizes.items()] + found
    for section, data in (
        ("CellData", {**piece.cell_data, **piece.derived}),
        ("FieldData", piece.field_data),
    ):
        for name, values in data.items():
            if "/" in name or name == ".":
                raise FileError(f"VTKHDF cannot hold a tag of the name {name!r}; .vtu can")
            found.append((f"{section}/{name}", values.astype(np.int32) if fits_in_index(values) else values))
    return found
