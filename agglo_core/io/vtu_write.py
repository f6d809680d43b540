"""Writing VTU: zlib in base64, version 1.0, which every VTK since 6 opens."""

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

from agglo_core.arrays import Float, Int, frozen_int
from agglo_core.io.atomic import staging
from agglo_core.io.level_values import (
    LevelValues,
    about_agglomerates,
    check_level_values,
    under_free_names,
)
from agglo_core.io.tags import BRIDGES, cell_data, check_names, is_level
from agglo_core.io.vtu_arrays import DERIVED
from agglo_core.io.vtu_cells import POLYHEDRON, Cells, cells_of
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import take_cells
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


def write_vtu(
    path: Path,
    mesh: Mesh,
    hierarchy: Hierarchy | None,
    level_values: LevelValues | None = None,
    tell: Tell = to_nobody,
) -> None:
    """Write ``path``, and with a hierarchy each coarse mesh beside it as ``NAME_level0.vtu``, ….

    The fine mesh carries its cell tags and the labels of every level (``level_0``, …), a coarse mesh its
    tags and what is known of each agglomerate: ``agglomerate``, ``parent``, ``cells``, ``measure``,
    ``diameter`` and the ``level_values``. These are marked as derived, so that reading does not take
    them for tags; one whose name a tag has is written with ``agglo_`` before it.

    A cell of several boundary loops (a hole) is one polygon that traverses a bridge between them both ways;
    then integer cell data ``agglo_loops`` say how many loops each cell has. VTK reads such polygons but
    its triangulation does not fill them: colour the fine mesh by ``level_i`` to see a level whole.

    With a hierarchy of k levels, tags ``level_<number>`` of an earlier one are not written, and files
    ``NAME_level<number>.vtu`` with a number of k or more are removed from the folder if they begin as
    this writer's files do.

    Parameters
    ----------
    path : Path
    mesh : Mesh
    hierarchy : Hierarchy or None
    level_values : sequence of mappings of name to (k,) float, optional
        What was measured on the k agglomerates of each level, finest first; NaN and infinities are kept.

    Raises
    ------
    MeshError
        For a cell tag of the name ``agglo_loops``, or a name that XML cannot hold.
    OptionError
        If the values do not fit the levels.
    """
    levels = list(hierarchy.levels) if hierarchy is not None else []
    values = check_level_values(hierarchy, [{}] * len(levels) if level_values is None else level_values)
    tags = cell_data(mesh, hierarchy)
    check_names(tags)
    taken = {BRIDGES, *(name for name in mesh.cell_tags if not is_level(name))}
    with staging(path) as folder:
        own = part(tell, 0, 1 + len(levels))
        (folder / path.name).write_bytes(_document(mesh, tags, {}, own))
        for i, labels in enumerate(levels):
            own = part(tell, 1 + i, 1 + len(levels), f"level {i}")
            coarse = mesh.coarsen(labels)
            kept = {key: each for key, each in coarse.cell_tags.items() if not is_level(key)}
            derived = under_free_names(about_agglomerates(levels, i, coarse, values[i]), taken)
            name = f"{path.stem}_level{i}{path.suffix}"
            (folder / name).write_bytes(_document(coarse, kept, derived, own))
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


def _document(mesh: Mesh, tags: Mapping[str, Int], derived: Mapping[str, NDArray[Any]], tell: Tell) -> bytes:
    cells, data = cells_of(mesh), dict(tags)
    if (cells.loops > 1).any():
        data[BRIDGES] = cells.loops
    points, number = _used(mesh)
    lines = [
        *_HEAD,
        "<UnstructuredGrid>",
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{mesh.n_cells}">',
        "<Points>",
        _array("Points", points, components=3),
        "</Points>",
        "<Cells>",
        *_arrays(_cell_arrays(cells, number), part(tell, 1, 4)),
        "</Cells>",
        "<CellData>",
        *_arrays(data, part(tell, 2, 4)),
        *_arrays(derived, part(tell, 3, 4), DERIVED),
        "</CellData>",
        "</Piece>",
        "</UnstructuredGrid>",
        "</VTKFile>",
        "",
    ]
    return "\n".join(lines).encode()


def _used(mesh: Mesh) -> tuple[Float, Int]:
    """Points that faces use (a coarse mesh keeps all) as ``(n, 3)``, and the new number of each point."""
    used = np.zeros(mesh.n_points, bool)
    used[mesh.face_vertices] = True
    points = np.zeros((int(used.sum()), 3))
    points[:, : mesh.dim] = mesh.points[used]
    return points, frozen_int(np.cumsum(used) - 1)


def _cell_arrays(cells: Cells, number: Int) -> dict[str, NDArray[Any]]:
    faces = _face_stream(cells, number) if (cells.types == POLYHEDRON).any() else {}
    corners = {"connectivity": number[cells.vertices], "offsets": cells.offsets[1:]}
    return {**corners, "types": cells.types, **faces}


def _face_stream(cells: Cells, number: Int) -> dict[str, NDArray[Any]]:
    """Per polyhedron: number of faces, then each face's size and vertices, seen from outside the cell.

    Other cells end nowhere in the stream, which is -1.
    """
    own = np.flatnonzero(cells.types == POLYHEDRON)
    offsets, loop_offsets, vertices = take_cells(cells.solids, frozen_int(own))
    with_sizes = np.insert(number[vertices], loop_offsets[:-1], np.diff(loop_offsets))
    face_starts = loop_offsets[offsets] + offsets  # places in the stream that has the sizes
    ends = np.full(len(cells.types), -1)
    ends[own] = face_starts[1:] + np.arange(1, len(own) + 1)
    return {"faces": np.insert(with_sizes, face_starts[:-1], np.diff(offsets)), "faceoffsets": ends}


def _arrays(arrays: Mapping[str, NDArray[Any]], tell: Tell, mark: str = "") -> Iterator[str]:
    for place, (name, values) in enumerate(arrays.items()):
        part(tell, place, len(arrays), name)
        yield _array(name, values, mark=mark)


def _array(name: str, values: NDArray[Any], components: int = 1, mark: str = "") -> str:
    kind = _NAMES[values.dtype.str[1:]]
    more = (f' NumberOfComponents="{components}"' if components > 1 else "") + (mark and f" {mark}")
    content = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    head = f'<DataArray type="{kind}" Name={quoteattr(name)}{more} format="binary">'
    return f"{head}{_encode(content)}</DataArray>"


def _encode(content: bytes) -> str:
    """Blocks of zlib data behind a header of their number and sizes, both in base64."""
    blocks = [zlib.compress(content[i : i + _BLOCK], 6) for i in range(0, len(content), _BLOCK)]
    sizes = (len(blocks), _BLOCK, len(content) % _BLOCK, *(len(block) for block in blocks))
    header = np.array(sizes, "<u8").tobytes()
    return (base64.b64encode(header) + base64.b64encode(b"".join(blocks))).decode()
