"""Read and write .pvtu files, which list the .vtu files with the pieces of a mesh."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path, PurePosixPath
from xml.sax.saxutils import quoteattr

from agglo_core.errors import FileError
from agglo_core.files.regular import file_bytes
from agglo_core.io.to_mesh.options import Reading
from agglo_core.io.vtk.pieces import Stored, mesh_from_pieces
from agglo_core.io.vtk.vtu import read_pieces
from agglo_core.io.vtk.xml_read import vtk_root
from agglo_core.io.vtk.xml_write import Piece, global_ids, stored_arrays
from agglo_core.mesh import Mesh


class Pvtu(Reading):
    """Pieces of a parallel unstructured grid as one mesh, without ghost cells.

    Without merged points, adjacent pieces remain separate.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read a PVTU file and the VTU files beside it.

        Cells are in piece order.

        Raises
        ------
        FileError, MeshError
            With the missing or broken piece, or for a piece in another location or listed twice.
        """
        files = [read_piece(path.parent, source) for source in sources_of(file_bytes(path))]
        if not files:
            raise FileError("it has no element Piece")
        return mesh_from_pieces(join_contents(files), **self.reading, name=path.stem)


def join_contents(files: Sequence[Stored]) -> Stored:
    """Join the pieces read from several files into one list."""
    return Stored(
        list(chain.from_iterable(file.pieces for file in files)),
        list(chain.from_iterable(file.left_out for file in files)),
        all(file.ours for file in files),
    )


def sources_of(content: bytes) -> list[str]:
    """Return the paths of the VTU files that a PVTU file lists.

    Raises FileError for duplicates and paths outside the folder.
    """
    root = vtk_root(content, "PUnstructuredGrid")
    sources = []
    for number, piece in enumerate(root.iterfind("PUnstructuredGrid/Piece")):
        source = piece.get("Source", "").replace("\\", "/")
        parts = PurePosixPath(source)
        if not parts.parts or "\0" in source:
            raise FileError(f"piece {number} has no attribute Source")
        if parts.is_absolute() or ".." in parts.parts or ":" in parts.parts[0]:
            raise FileError(f"piece {source!r} is outside the folder of the file, where all pieces must be")
        if str(parts) in sources:
            raise FileError(f"piece {source!r} is listed twice")
        sources.append(str(parts))
    return sources


def read_piece(folder: Path, source: str) -> Stored:
    """Read all pieces in one of the VTU files that a PVTU file lists.

    Errors name the file.
    """
    try:
        content = file_bytes(folder / source)
    except FileError as error:
        raise FileError(f"piece {source!r}: {error}") from None
    except OSError as error:
        raise FileError(f"piece {source!r}: {error.strerror or error}") from error
    try:
        return read_pieces(content)
    except FileError as error:
        raise FileError(f"piece {source!r}: {error}") from error.__cause__


_START = (
    '<?xml version="1.0"?>\n'
    '<VTKFile type="PUnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    ' agglo="{kind}">\n<PUnstructuredGrid GhostLevel="0">\n'
)
PIECES = _START.format(kind="mesh").encode()
"""First bytes of a piece list for a mesh written by agglo."""


def piece_name(stem: str, rank: int) -> str:
    """Return the VTU file path of an MPI rank, relative to ``STEM.pvtu``."""
    return f"{stem}/{stem}_{rank}.vtu"


def pvtu_list(piece: Piece, sources: Sequence[str]) -> bytes:
    """Return the PVTU file that lists the given VTU files, whose arrays match those of ``piece``."""
    arrays = list(stored_arrays(piece))
    lines = []
    for section in ("PointData", "CellData", "Points"):
        elements = [f"<PDataArray {array.attributes}/>" for array in arrays if array.section == section]
        lines += [f"<P{section}{global_ids(piece, section)}>", *elements, f"</P{section}>"]
    lines += [f"<Piece Source={quoteattr(source)}/>" for source in sources]
    ends = "</PUnstructuredGrid>", "</VTKFile>"
    return (_START.format(kind=piece.kind) + "\n".join([*lines, *ends])).encode() + b"\n"
