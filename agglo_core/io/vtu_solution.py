"""Writing a solution as VTU: a function sampled cell by cell, with its jumps."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.errors import FileError
from agglo_core.io.atomic import staging
from agglo_core.io.file_checks import naming
from agglo_core.io.level_values import under_free_names
from agglo_core.io.tags import check_names
from agglo_core.io.vtu_document import Piece, write_document
from agglo_core.mesh import Mesh
from agglo_core.problems.discretisation import Samples

__all__ = ["write_solution"]

_SIMPLICES = {3: 5, 4: 10}  # corners to VTK's number of triangles and tetrahedra


def write_solution(path: str | PathLike[str], mesh: Mesh, samples: Samples, *, name: str = "u") -> None:
    """Write a sampled function to a ``.vtu`` file that ParaView and VTK open.

    No two cells share points, so jumps stay visible and holes empty. Cell data: ``cell``, the number of the
    cell in the mesh, and the mesh's cell tags; ``agglo_cell`` if one of them is called ``cell``.

    Raises
    ------
    FileError
        For another suffix, or a file that cannot be written.
    MeshError
        For a cell tag whose name files cannot hold.
    """
    path = Path(path)
    if path.suffix.lower() != ".vtu":
        raise FileError(f"{path}: a solution is written as .vtu")
    owners = samples.cells[samples.simplices[:, 0]]
    tags = {tag: each[owners] for tag, each in mesh.cell_tags.items()}
    data = under_free_names({"cell": owners}, tags) | tags
    with naming(path), staging(path) as folder:
        check_names(tags)
        write_document(folder / path.name, _piece(samples, {name: samples.values}, data))


def _piece(samples: Samples, fields: Mapping[str, NDArray[Any]], data: Mapping[str, NDArray[Any]]) -> Piece:
    n, corners = samples.simplices.shape
    cells: dict[str, NDArray[Any]] = {
        "connectivity": samples.simplices.ravel(),
        "offsets": corners * np.arange(1, n + 1),
        "types": np.full(n, _SIMPLICES[corners], np.uint8),
    }
    return Piece(samples.points, cells, fields, data, kind="solution")
