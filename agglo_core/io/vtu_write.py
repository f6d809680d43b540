"""Writing VTU: polygons or polyhedra, zlib in base64, version 1.0, which every VTK since 6 opens."""

from __future__ import annotations

import base64
import logging
import re
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.io.atomic import staging
from agglo_core.io.bridges import single_loops
from agglo_core.io.tags import BRIDGES, cell_data, check_names, is_level
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import gather
from agglo_core.progress import Tell, part, to_nobody

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

__all__ = ["write_vtu"]

_NAMES = {"i1": "Int8", "i2": "Int16", "i4": "Int32", "i8": "Int64", "u1": "UInt8", "f8": "Float64"}
_BLOCK = 1 << 20  # bytes compressed at once
_HEAD = (
    '<?xml version="1.0"?>',
    '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
    'header_type="UInt64" compressor="vtkZLibDataCompressor">',
)
_log = logging.getLogger("agglo")


def write_vtu(path: Path, mesh: Mesh, hierarchy: Hierarchy | None, tell: Tell = to_nobody) -> None:
    """Write ``path``, and with a hierarchy each coarse mesh beside it as ``NAME_level0.vtu``, ….

    The fine mesh carries its cell tags and the labels of every level (``level_0``, …). A cell of
    several boundary loops (a hole) is one polygon that traverses a bridge between them both ways; then
    integer cell data ``agglo_loops`` say how many loops each cell has. VTK reads such polygons but
    its triangulation does not fill them: colour the fine mesh by ``level_i`` to see a level whole.

    With a hierarchy of k levels, tags ``level_<number>`` of an earlier one are not written, and files
    ``NAME_level<number>.vtu`` with a number of k or more are removed from the folder if they begin as
    this writer's files do.

    Raises
    ------
    MeshError
        For a cell tag of the name ``agglo_loops``, or of one that XML cannot hold.
    """
    levels = list(hierarchy.levels) if hierarchy is not None else []
    tags = cell_data(mesh, hierarchy)
    check_names(tags)
    with staging(path) as folder:
        own = part(tell, 0, 1 + len(levels))
        (folder / path.name).write_bytes(_document(mesh, tags, own))
        for i, labels in enumerate(levels):
            own = part(tell, 1 + i, 1 + len(levels), f"level {i}")
            coarse = mesh.coarsen(labels)
            name = f"{path.stem}_level{i}{path.suffix}"
            kept = {key: values for key, values in coarse.cell_tags.items() if not is_level(key)}
            (folder / name).write_bytes(_document(coarse, kept, own))
    if levels:
        _remove_stale(path, len(levels))


def _remove_stale(path: Path, count: int) -> None:
    """Remove the coarse meshes of an earlier, deeper hierarchy, which would pass for levels of this one."""
    head = "\n".join(_HEAD).encode()
    pattern = re.compile(re.escape(f"{path.stem}_level") + r"(0|[1-9]\d*)" + re.escape(path.suffix), re.ASCII)
    for file in sorted(path.parent.iterdir()):
        found = pattern.fullmatch(file.name)
        if found is None or int(found[1]) < count or file.is_symlink() or not file.is_file():
            continue
        try:
            with open(file, "rb") as stream:
                ours = stream.read(len(head)) == head
            if ours:
                file.unlink()
                _log.info("removed %s, a level of an earlier hierarchy", file)
        except OSError as error:  # the mesh and its levels are written: this is not a reason to fail
            _log.warning("cannot remove %s, a level of an earlier hierarchy: %s", file, error.strerror)


def _document(mesh: Mesh, tags: Mapping[str, Int], tell: Tell) -> bytes:
    data = dict(tags)
    if mesh.dim == 2:
        offsets, vertices, loops = single_loops(mesh)
        points, vertices = _used(mesh, vertices)
        cells = _cells(offsets, vertices, 7)
        if (loops > 1).any():
            data[BRIDGES] = loops
    else:
        offsets, vertices = mesh.cell_vertices
        points, vertices = _used(mesh, frozen_int(vertices))
        cells = {**_cells(offsets, vertices, 42), **_face_stream(mesh)}
    lines = [
        *_HEAD,
        "<UnstructuredGrid>",
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{mesh.n_cells}">',
        "<Points>",
        _array("Points", points, components=3),
        "</Points>",
        "<Cells>",
        *_arrays(cells, part(tell, 1, 3)),
        "</Cells>",
        "<CellData>",
        *_arrays(data, part(tell, 2, 3)),
        "</CellData>",
        "</Piece>",
        "</UnstructuredGrid>",
        "</VTKFile>",
        "",
    ]
    return "\n".join(lines).encode()


def _cells(offsets: Int, vertices: Int, kind: int) -> dict[str, NDArray[Any]]:
    types = np.full(len(offsets) - 1, kind, np.uint8)
    return {"connectivity": vertices, "offsets": offsets[1:], "types": types}


def _point_numbers(mesh: Mesh) -> tuple[NDArray[Any], Int]:
    """Which points the faces use (a coarse mesh keeps all points), and their new numbers."""
    used = np.zeros(mesh.n_points, bool)
    used[mesh.face_vertices] = True
    return used, frozen_int(np.cumsum(used) - 1)


def _used(mesh: Mesh, vertices: Int) -> tuple[NDArray[Any], Int]:
    """Points in use as ``(n, 3)``, and the vertices renumbered to them."""
    used, number = _point_numbers(mesh)
    points = np.zeros((int(used.sum()), 3))
    points[:, : mesh.dim] = mesh.points[used]
    return points, frozen_int(number[vertices])


def _face_stream(mesh: Mesh) -> dict[str, NDArray[Any]]:
    """Per cell: number of faces, then each face's size and vertices, seen from outside the cell."""
    offsets, faces = mesh.cell_faces
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
    number = _point_numbers(mesh)[1]
    loop_offsets, places = gather(mesh.face_offsets, faces)
    sizes = np.diff(loop_offsets)
    ends = np.repeat(mesh.face_offsets[faces] + mesh.face_offsets[faces + 1] - 1, sizes)
    inward = np.repeat(mesh.face_cells[faces, 0] != cells, sizes)
    vertices = number[mesh.face_vertices[np.where(inward, ends - places, places)]]
    with_sizes = np.insert(vertices, loop_offsets[:-1], sizes)
    face_starts = loop_offsets[offsets] + offsets  # places in the stream that has the sizes
    stream = np.insert(with_sizes, face_starts[:-1], np.diff(offsets))
    return {"faces": stream, "faceoffsets": face_starts[1:] + np.arange(1, mesh.n_cells + 1)}


def _arrays(arrays: Mapping[str, NDArray[Any]], tell: Tell) -> Iterator[str]:
    for place, (name, values) in enumerate(arrays.items()):
        part(tell, place, len(arrays), name)
        yield _array(name, values)


def _array(name: str, values: NDArray[Any], components: int = 1) -> str:
    kind = _NAMES[values.dtype.str[1:]]
    size = f' NumberOfComponents="{components}"' if components > 1 else ""
    content = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    head = f'<DataArray type="{kind}" Name={quoteattr(name)}{size} format="binary">'
    return f"{head}{_encode(content)}</DataArray>"


def _encode(content: bytes) -> str:
    """Blocks of zlib data behind a header of their number and sizes, both in base64."""
    blocks = [zlib.compress(content[i : i + _BLOCK], 6) for i in range(0, len(content), _BLOCK)]
    sizes = (len(blocks), _BLOCK, len(content) % _BLOCK, *(len(block) for block in blocks))
    header = np.array(sizes, "<u8").tobytes()
    return (base64.b64encode(header) + base64.b64encode(b"".join(blocks))).decode()
