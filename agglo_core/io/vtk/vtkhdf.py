"""Read and write VTKHDF: unstructured grids in HDF5 with one or more partitions, without time steps."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, fits_in_index, frozen_float, frozen_int
from agglo_core.errors import AggloError, FileError
from agglo_core.io.levels import LevelValues
from agglo_core.io.tags import tag_values
from agglo_core.io.to_mesh.listed_faces import parse_listed_faces
from agglo_core.io.to_mesh.options import Compressing
from agglo_core.io.to_mesh.soup import Soup
from agglo_core.io.vtk.cells import POLYHEDRON, Cells
from agglo_core.io.vtk.grids import Storage, renumber_vertices, write_grids
from agglo_core.io.vtk.hdf_arrays import (
    COUNTS,
    DERIVED,
    GROUP,
    NAMES,
    Partition,
    datasets,
    hdf5,
    member,
    subgroup,
)
from agglo_core.io.vtk.pieces import Stored, check_counts, mesh_from_pieces, soup_of_piece
from agglo_core.io.vtk.xml_write import Piece
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import take_cells
from agglo_core.progress import Notify, ignore_progress, part

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

_SPARE, _EXPANSION = 1 << 24, 400  # bytes allowed for arrays: fixed, and per byte of the file


class VtkHdf(Compressing):
    """VTKHDF unstructured grids: any mesh with its tags and all level labels, as in ``.vtu``."""

    lossless: bool = False
    atomic: bool = True
    reports_progress: bool = True
    keeps_level_values: bool = True

    def read(self, path: Path) -> Mesh:
        """Read the mesh in a VTKHDF file.

        Partitions are joined, integer cell data become cell tags.

        Raises
        ------
        FileError, MeshError
            If h5py is not installed; for other dataset types, time steps, or a broken file or mesh.
        """
        h5py = hdf5()
        try:
            with h5py.File(path, "r") as file:
                stored = _read_group(file, _SPARE + _EXPANSION * path.stat().st_size)
        except AggloError:
            raise
        except (OSError, RuntimeError, ValueError, KeyError, TypeError, OverflowError, MemoryError) as error:
            raise FileError(f"HDF5 cannot read it: {str(error)[:200]}") from None
        return mesh_from_pieces(stored, **self.reading, name=path.stem)

    def write(
        self,
        path: Path,
        mesh: Mesh,
        hierarchy: Hierarchy | None = None,
        level_values: LevelValues | None = None,
        notify: Notify = ignore_progress,
    ) -> None:
        """Write a mesh to ``path``, and each coarse mesh to a file beside it, see :func:`write_grids`.

        Raises
        ------
        FileError
            If h5py is not installed, or HDF5 cannot hold the name of a tag.
        """
        hdf5()
        write_grids(
            Storage(_write, _faces, _is_own_file),
            path,
            mesh,
            hierarchy,
            level_values,
            notify,
            compress=self.compress,
        )


def _read_group(file: Any, max_bytes: int) -> Stored:
    group = subgroup(file, GROUP)
    if group is None:
        raise FileError(f"is an HDF5 file without the group {GROUP!r}")
    kind = group.attrs.get("Type", b"")
    kind = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
    if kind != "UnstructuredGrid":
        raise FileError(f"holds a {kind or 'data set without Type'}, expected a VTKHDF UnstructuredGrid")
    if "Steps" in group:
        raise FileError("holds time steps, which are not supported; write one of them to a separate file")
    _check_sizes(group, max_bytes)
    tags, skipped_names = _tags(group)
    pieces = list(_pieces(group, tags))
    if len(pieces) == 1 and "agglo" in group.attrs:
        n_points, n = len(pieces[0].points), len(pieces[0].types)
        pieces = [pieces[0]._replace(listed=parse_listed_faces(_fields(group), n_points, n))]
    return Stored(pieces, skipped_names)


def _check_sizes(group: Any, max_bytes: int) -> None:
    """Reject files whose arrays are far larger than the file, as compressed data can be."""
    total = 0
    for section in (group, subgroup(group, "CellData"), subgroup(group, "FieldData")):
        for name, dataset in datasets(section).items():
            size = int(dataset.nbytes)
            total += size
            if total > max_bytes:
                raise FileError(f"dataset {name!r} declares {size} bytes, far too many for the file size")


def _tags(group: Any) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Return integer cell data with one component, and the names of skipped cell data."""
    section = subgroup(group, "CellData")
    tags, skipped_names = {}, []
    for name, dataset in datasets(section).items():
        if DERIVED in dataset.attrs:
            continue
        if dataset.dtype.kind in "iu" and (dataset.ndim == 1 or dataset.shape[1:] == (1,)):
            tags[name] = np.asarray(member(section, name)[()]).ravel()
        else:
            skipped_names.append(name)
    return tags, skipped_names


def _fields(group: Any) -> dict[str, NDArray[Any]]:
    section = subgroup(group, "FieldData")
    numbers = [name for name, dataset in datasets(section).items() if dataset.dtype.kind in "iu"]
    return {name: np.asarray(member(section, name)[()]).ravel() for name in numbers}


def _pieces(group: Any, tags: dict[str, NDArray[Any]]) -> Iterator[Soup]:
    n_points, n_cells = (_counts(group, f"NumberOf{what}") for what in ("Points", "Cells"))
    array_counts = {name: _counts(group, COUNTS[name]) for name in COUNTS if COUNTS[name] in group}
    # Check all array lengths before the first array is read.
    for name, counts in {"NumberOfPoints": n_points, **array_counts}.items():
        if len(counts) != len(n_cells):
            raise FileError(
                f"{name!r} is given for {len(counts)} partitions, but the cells for {len(n_cells)}"
            )
    points = member(group, "Points")
    if points is None or points.ndim != 2 or points.shape[1] != 3 or len(points) < n_points.sum():
        raise FileError(f"dataset 'Points' is missing, or does not have the shape ({n_points.sum()}, 3)")
    for name, values in tags.items():
        if len(values) < n_cells.sum():
            raise FileError(f"cell data {name!r} has {len(values)} values for {n_cells.sum()} cells")
    # Read partition by partition.
    for i, (m, n) in enumerate(zip(n_points.tolist(), n_cells.tolist(), strict=True)):
        check_counts(m, n)
        first, start = int(n_points[:i].sum()), int(n_cells[:i].sum())
        spans = {name: (int(c[:i].sum()), int(c[: i + 1].sum())) for name, c in array_counts.items()}
        piece_points = frozen_float(points[first : first + m])
        soup = soup_of_piece(Partition(group, (start, start + n), spans, i), piece_points, n)
        data = (
            {name: tag_values(name, values[start : start + n]) for name, values in tags.items()} if n else {}
        )
        yield soup._replace(tags=data)


def _counts(group: Any, name: str) -> Int:
    dataset = member(group, name)
    if dataset is None or dataset.ndim != 1 or dataset.dtype.kind not in "iu":
        raise FileError(f"dataset {name!r} is missing, or not a list of whole numbers")
    counts = tag_values(name, np.asarray(dataset[()]))
    if not len(counts) or counts.min() < 0 or counts.max() >= 1 << 40:
        raise FileError(f"dataset {name!r} holds {counts.tolist()[:3]}, which are not valid counts")
    return counts


_VERSION, _WITH_FACES = (2, 0), (2, 5)  # format versions: for such files in general, and with polyhedra
_LEVEL = 1  # deflate level: higher levels take twice the time and save a few per cent


def _is_own_file(file: Path) -> bool:
    with hdf5().File(file) as hdf_file:
        stored = isinstance(hdf_file.get(GROUP, getlink=True), hdf5().HardLink)
        return stored and "agglo" in hdf_file[GROUP].attrs


def _faces(cells: Cells, number: Int | None) -> dict[str, NDArray[Any]]:
    """Return the arrays that describe the faces of all polyhedra, separately for each polyhedron.

    Other cells have none.
    """
    is_polyhedron = cells.types == POLYHEDRON
    offsets, loop_offsets, vertices = take_cells(cells.solids, frozen_int(np.flatnonzero(is_polyhedron)))
    counts = np.zeros(len(is_polyhedron), np.int64)
    counts[is_polyhedron] = np.diff(offsets)
    return {
        "face_connectivity": renumber_vertices(vertices, number),
        "face_offsets": loop_offsets[1:],
        "polyhedron_to_faces": np.arange(len(loop_offsets) - 1),
        "polyhedron_offsets": np.cumsum(counts),
    }


def _write(path: Path, piece: Piece, *, compress: bool, notify: Notify) -> None:
    options = {"compression": "gzip", "compression_opts": _LEVEL, "shuffle": True} if compress else {}
    with hdf5().File(path, "w") as file:
        group = file.create_group(GROUP)
        group.attrs["Version"] = np.array(_WITH_FACES if "face_offsets" in piece.cells else _VERSION)
        group.attrs["Type"] = np.bytes_(b"UnstructuredGrid")
        group.attrs["agglo"] = np.bytes_(piece.kind.encode())
        arrays = list(_arrays(piece))
        for place, (name, values) in enumerate(arrays):
            part(notify, place, len(arrays), name)
            group.create_dataset(name, data=values, **(options if values.size > 1 else {}))
        for name in piece.derived:
            group[f"CellData/{name}"].attrs[DERIVED] = np.bytes_(b"derived")


def _arrays(piece: Piece) -> list[tuple[str, NDArray[Any]]]:
    points = np.zeros((len(piece.points), 3))
    points[:, : piece.points.shape[1]] = piece.points
    arrays: list[tuple[str, NDArray[Any]]] = [("Points", points)]
    sizes = {"NumberOfPoints": len(points), "NumberOfCells": len(piece.cells["types"])}
    for name, values in piece.cells.items():
        stored = NAMES[name]
        whole = np.concatenate(([0], values)) if stored.endswith("Offsets") else values
        arrays.append((stored, whole if values.dtype == np.uint8 else whole.astype(np.int64)))
        if name in COUNTS:
            sizes[COUNTS[name]] = len(values)
    arrays = [(name, np.array([count])) for name, count in sizes.items()] + arrays
    for section, data in (
        ("CellData", {**piece.cell_data, **piece.derived}),
        ("FieldData", piece.field_data),
    ):
        for name, values in data.items():
            if "/" in name or name == ".":
                raise FileError(f"VTKHDF cannot hold a tag named {name!r}; .vtu can")
            arrays.append((f"{section}/{name}", values.astype(np.int32) if fits_in_index(values) else values))
    return arrays
