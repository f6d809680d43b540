"""Write a discrete solution as VTU: a function sampled cell by cell, with its jumps between cells."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int
from agglo_core.errors import FileError
from agglo_core.io.atomic import staging
from agglo_core.io.file_checks import name_in_errors
from agglo_core.io.levels import under_free_names
from agglo_core.io.tags import check_names
from agglo_core.io.vtk.xml_write import Piece, write_document
from agglo_core.mesh import Mesh
from agglo_core.problems.discretisation import Samples

_SIMPLICES = {3: 5, 4: 10}  # number of corners -> VTK type of triangles and tetrahedra


def write_solution(path: str | PathLike[str], mesh: Mesh, samples: Samples, *, name: str = "u") -> None:
    """Write a function, sampled cell by cell, to a ``.vtu`` file for ParaView and VTK.

    Cells share no points, so jumps are visible and holes are empty. Cell data: ``cell``, the cell number in
    the mesh (``agglo_cell`` if a tag is called ``cell``), and the mesh's cell tags.

    Raises
    ------
    FileError
        For another suffix, or a file that cannot be written.
    MeshError
        If files cannot hold a tag name.
    """
    path = Path(path)
    if path.suffix.lower() != ".vtu":
        raise FileError(f"{path}: a solution can only be written as .vtu")
    with name_in_errors(path), staging(path) as folder:
        piece = solution_piece(samples, mesh.cell_tags, name=name)
        write_document(folder / path.name, piece)


def solution_piece(
    samples: Samples, tags: Mapping[str, Int], *, name: str = "u", cell_ids: Int | None = None
) -> Piece:
    """Return VTU file contents with a function sampled on simplices.

    Parameters
    ----------
    samples : Samples
    tags : mapping of str to (n_cells,) int
        Mesh cell tags.
    name : str
        Function name.
    cell_ids : (n_cells,) int, optional
        Cell numbers in the file; by default those in the mesh.

    Raises
    ------
    MeshError
        If files cannot hold a tag name.
    """
    check_names(tags)
    owners = samples.cells[samples.simplices[:, 0]]
    cell_tags = {tag: values[owners] for tag, values in tags.items()}
    numbers = owners if cell_ids is None else cell_ids[owners]
    data = under_free_names({"cell": numbers}, cell_tags) | cell_tags
    n, corners = samples.simplices.shape
    cells: dict[str, NDArray[Any]] = {
        "connectivity": samples.simplices.ravel(),
        "offsets": corners * np.arange(1, n + 1),
        "types": np.full(n, _SIMPLICES[corners], np.uint8),
    }
    return Piece(samples.points, cells, {name: samples.values}, data, kind="solution")
