"""Writing a solution as VTU: discontinuous polynomials, sampled cell by cell."""

from __future__ import annotations

import base64
from os import PathLike
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Float, Int
from agglo_core.errors import FileError
from agglo_core.io.atomic import staging
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.quadrature import triangulate

__all__ = ["sampled", "write_solution"]

_NAMES = {"f8": "Float64", "i8": "Int64", "u1": "UInt8"}


def write_solution(path: str | PathLike[str], basis: Basis, x: Float, *, name: str = "u") -> None:
    """Write the function with coefficients ``x (n,)`` to a ``.vtu`` file that ParaView and VTK open.

    Every cell is cut into triangles, each of them into p² smaller ones, and no two cells share points, so
    jumps stay visible and holes empty. Cell data: ``cell``, the number of the cell in the mesh, and the
    mesh's cell tags.

    Raises
    ------
    FileError
        For another suffix, or a file that cannot be written.
    OptionError
        If x has another length than the space.
    """
    path = Path(path)
    if path.suffix.lower() != ".vtu":
        raise FileError(f"{path}: a solution is written as .vtu")
    cells, points, triangles = sampled(basis)
    values = basis.evaluate(x, cells, points)
    owners = cells[triangles[:, 0]]
    data = {"cell": owners, **{tag: each[owners] for tag, each in basis.mesh.cell_tags.items()}}
    try:
        with staging(path) as folder:
            (folder / path.name).write_text(_document(points, triangles, {name: values}, data))
    except OSError as error:
        raise FileError(f"{path}: {error.strerror or error}") from error


def sampled(basis: Basis) -> tuple[Int, Float, Int]:
    """Points that sample every cell: their cells ``(q,)``, the points ``(q, 2)`` and triangles ``(t, 3)``."""
    offsets, corners = triangulate(basis.mesh)
    p = basis.degree
    lattice = np.array([(i, j) for j in range(p + 1) for i in range(p + 1 - j)])
    number = {(i, j): k for k, (i, j) in enumerate(lattice.tolist())}
    small = [(number[i, j], number[i + 1, j], number[i, j + 1]) for i, j in number if i + j < p]
    small += [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]) for i, j in number if i + j < p - 1]
    u, v = (corners[:, k] - corners[:, 0] for k in (1, 2))
    points = corners[:, None, 0] + (lattice[:, :1] * u[:, None] + lattice[:, 1:] * v[:, None]) / p
    cells = np.repeat(np.arange(basis.mesh.n_cells), np.diff(offsets) * len(lattice))
    triangles = np.array(small) + len(lattice) * np.arange(len(corners))[:, None, None]
    return cells, points.reshape(-1, 2) + basis.mesh.origin, triangles.reshape(-1, 3)


def _document(points: Float, triangles: Int, fields: dict[str, Float], data: dict[str, NDArray[Any]]) -> str:
    n = len(triangles)
    cells: dict[str, NDArray[Any]] = {
        "connectivity": triangles.ravel(),
        "offsets": 3 * np.arange(1, n + 1),
        "types": np.full(n, 5, np.uint8),
    }
    space = np.column_stack((points, np.zeros(len(points))))
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
