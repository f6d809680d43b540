"""Write a discrete solution as VTU: a function sampled cell by cell, with its jumps between cells."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.errors import FileError, MeshError
from agglo_core.io.atomic import staging
from agglo_core.io.file_checks import name_in_errors
from agglo_core.io.levels import under_free_names
from agglo_core.io.tags import check_names
from agglo_core.io.to_mesh.plain_cells import half_faces
from agglo_core.io.vtk.cells import POLYHEDRON, Cells
from agglo_core.io.vtk.vtu import face_stream
from agglo_core.io.vtk.xml_write import Piece, write_document
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import name_cells
from agglo_core.mesh.elements import gather, take_cells
from agglo_core.problems.discretisation import Samples

_FACES = {2: 3, 3: 7}  # dimension -> VTK type of lines and polygons
_SIMPLICES = {3: 5, 4: 10}  # number of corners -> VTK type of triangles and tetrahedra


def write_solution(path: str | PathLike[str], mesh: Mesh, samples: Samples, *, name: str = "u") -> None:
    """Write a function, sampled cell by cell, to a ``.vtu`` file for ParaView and VTK.

    Cells share no points, so jumps are visible and holes are empty. Cell data: ``cell``, the cell number in
    the mesh (``agglo_cell`` if a tag is called ``cell``), the mesh's cell tags, and what the samples have of
    ``gradient``, ``stress`` and ``von_mises`` at the centroid of each simplex. A cell without simplices is
    one polyhedron with values at its vertices, and these three are NaN there.

    Raises
    ------
    FileError
        For another suffix, or a file that cannot be written.
    MeshError
        If files cannot hold a tag name.
    """
    with _vtu_file(path, "a solution") as target:
        write_document(target, solution_piece(samples, mesh, name=name))


def write_fluxes(path: str | PathLike[str], mesh: Mesh, fluxes: Float) -> None:
    """Write the faces of a mesh with the ``fluxes (n_faces,)`` through them to a ``.vtu`` file.

    Cell data: ``flux``, ``flux_density`` (by face measure), for vectors ``force`` and ``traction`` instead,
    ``first_cell``, ``second_cell`` (−1 outside), and the mesh's face tags. Fluxes are outward of the first
    cell, and forces act on it.

    Raises
    ------
    FileError
        For another suffix, or a file that cannot be written.
    MeshError
        If files cannot hold a tag name.
    """
    first, second = mesh.face_cells.T
    whole, density = ("flux", "flux_density") if fluxes.ndim == 1 else ("force", "traction")
    data = {
        whole: fluxes,
        density: (fluxes.T / mesh.face_measures).T,
        "first_cell": first,
        "second_cell": second,
    }
    cells: dict[str, NDArray[Any]] = {
        "connectivity": mesh.face_vertices,
        "offsets": mesh.face_offsets[1:],
        "types": np.full(mesh.n_faces, _FACES[mesh.dim], np.uint8),
    }
    with _vtu_file(path, "fluxes") as target:
        check_names(mesh.face_tags)
        named = under_free_names(data, mesh.face_tags) | dict(mesh.face_tags)
        write_document(target, Piece(mesh.points, cells, {}, named, kind="solution"))


@contextmanager
def _vtu_file(path: str | PathLike[str], content: str) -> Iterator[Path]:
    """Yield the path to write a ``.vtu`` file to, which replaces ``path`` once it is complete."""
    path = Path(path)
    if path.suffix.lower() != ".vtu":
        raise FileError(f"{path}: {content} can only be written as .vtu")
    with name_in_errors(path), staging(path) as folder:
        yield folder / path.name


def solution_piece(samples: Samples, mesh: Mesh, *, name: str = "u", cell_ids: Int | None = None) -> Piece:
    """Return VTU file contents with a sampled function.

    Parameters
    ----------
    samples : Samples
    mesh : Mesh
    name : str
        Function name.
    cell_ids : (n_cells,) int, optional
        Cell numbers in the file; by default those in the mesh.

    Raises
    ------
    MeshError
        If files cannot hold a tag name, or for cells without simplices, except polyhedra sampled at
        their vertices.
    """
    check_names(mesh.cell_tags)
    owners = samples.cells[samples.simplices[:, 0]]
    whole = frozen_int(np.setdiff1d(samples.cells, owners))
    owners = np.concatenate((owners, whole))
    cell_tags = {tag: values[owners] for tag, values in mesh.cell_tags.items()}
    numbers = owners if cell_ids is None else cell_ids[owners]
    data: dict[str, NDArray[Any]] = {"cell": numbers}
    if samples.gradients is not None:
        data["gradient"] = _with_gaps(samples.gradients, len(whole))
    if samples.stresses is not None:
        stresses = _with_gaps(samples.stresses, len(whole))
        data |= {"stress": stresses, "von_mises": _von_mises(stresses)}
    data = under_free_names(data, cell_tags) | cell_tags
    n, corners = samples.simplices.shape
    cells: dict[str, NDArray[Any]] = {
        "connectivity": samples.simplices.ravel(),
        "offsets": corners * np.arange(1, n + 1),
        "types": np.full(n, _SIMPLICES[corners], np.uint8),
    }
    if len(whole):
        cells = _with_polyhedra(cells, samples, mesh, whole)
    return Piece(samples.points, cells, {name: samples.values}, data, kind="solution")


def _with_polyhedra(
    cells: Mapping[str, NDArray[Any]], samples: Samples, mesh: Mesh, whole: Int
) -> dict[str, NDArray[Any]]:
    """Append the cells ``whole`` as polyhedra, with their sample points as vertices."""
    # 1. The sample points of these cells, which are their vertices.
    numbers = np.flatnonzero(np.isin(samples.cells, whole))
    numbers = numbers[np.argsort(samples.cells[numbers], kind="stable")]
    offsets, places = gather(mesh.cell_vertices[0], whole)
    vertices, counts = mesh.cell_vertices[1][places], np.diff(offsets)
    if mesh.dim == 2 or not np.array_equal(samples.points[numbers], mesh.points[vertices]):
        raise MeshError(f"{name_cells(whole)}: no simplices, and no polyhedra sampled at their vertices")
    # 2. Faces by these points.
    solids = take_cells(half_faces(mesh), whole)
    sizes = np.diff(solids.loop_offsets[solids.cell_offsets])
    row = np.arange(len(whole)) * mesh.n_points
    keys, wanted = np.repeat(row, counts) + vertices, np.repeat(row, sizes) + solids.vertices
    order = np.argsort(keys)
    corners = frozen_int(numbers[order[np.searchsorted(keys[order], wanted)]])
    # 3. One stream of faces. The other cells have no place in it.
    types = np.full(len(whole), POLYHEDRON, np.uint8)
    alone = Cells(types, offsets, frozen_int(numbers), solids._replace(vertices=corners), frozen_int([]))
    stream = face_stream(alone, None)
    none = np.full(len(cells["types"]), -1)
    return {
        "connectivity": np.concatenate((cells["connectivity"], numbers)),
        "offsets": np.concatenate((cells["offsets"], len(cells["connectivity"]) + offsets[1:])),
        "types": np.concatenate((cells["types"], types)),
        "faces": stream["faces"],
        "faceoffsets": np.concatenate((none, stream["faceoffsets"])),
    }


def _with_gaps(values: Float, count: int) -> Float:
    """Append ``count`` rows of NaN."""
    return np.concatenate((values, np.full((count, *values.shape[1:]), np.nan)))


def _von_mises(stresses: Float) -> Float:
    """Return the von Mises stress √(3/2) |dev σ| ``(n,)`` of ``stresses (n, 3, 3)``."""
    mean = np.trace(stresses, axis1=1, axis2=2) / 3.0
    return np.asarray(np.sqrt(1.5) * np.linalg.norm(stresses - mean[:, None, None] * np.eye(3), axis=(1, 2)))
