"""Writing a solution as VTU: a function sampled cell by cell, with its jumps."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from agglo_core.errors import FileError
from agglo_core.io.atomic import staging
from agglo_core.io.file_checks import naming
from agglo_core.io.level_values import under_free_names
from agglo_core.io.tags import check_names
from agglo_core.mesh import Mesh
from agglo_core.problems.discretisation import Samples

__all__ = ["write_solution"]

_NAMES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}
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
        (folder / path.name).write_text(_document(samples, {name: samples.values}, data), encoding="utf-8")


def _document(samples: Samples, fields: Mapping[str, NDArray[Any]], data: Mapping[str, NDArray[Any]]) -> str:
    points, (n, corners) = samples.points, samples.simplices.shape
    cells: dict[str, NDArray[Any]] = {
        "connectivity": samples.simplices.ravel(),
        "offsets": corners * np.arange(1, n + 1),
        "types": np.full(n, _SIMPLICES[corners], np.uint8),
    }
    space = np.column_stack((points, np.zeros((len(points), 3 - points.shape[1]))))
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        f'<UnstructuredGrid><Piece NumberOfPoints="{len(points)}" NumberOfCells="{n}">',
        f"<Points>{_array('Points', space, 3)}</Points>",
        f"<Cells>{''.join(_array(*each) for each in cells.items())}</Cells>",
        f"<PointData>{''.join(_array(*each) for each in fields.items())}</PointData>",
        f"<CellData>{''.join(_array(*each) for each in data.items())}</CellData>",
        "</Piece></UnstructuredGrid></VTKFile>",
        "",
    ]
    return "\n".join(lines)


def _array(name: str, values: NDArray[Any], components: int = 1) -> str:
    """A DataArray: the number of bytes and the bytes, in base64."""
    content = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    coded = base64.b64encode(np.array([len(content)], "<u8").tobytes() + content).decode()
    kind = f'type="{_NAMES[values.dtype.str[1:]]}" NumberOfComponents="{components}"'
    return f'<DataArray {kind} Name={quoteattr(name)} format="binary">{coded}</DataArray>'
