"""Writing PVTU: the list of pieces, with the names and types of their arrays."""

from __future__ import annotations

from collections.abc import Sequence
from xml.sax.saxutils import quoteattr

from agglo_core.io.vtk.document import Piece, global_ids, stored_arrays

_START = (
    '<?xml version="1.0"?>\n'
    '<VTKFile type="PUnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    ' agglo="{kind}">\n<PUnstructuredGrid GhostLevel="0">\n'
)
PIECES = _START.format(kind="mesh").encode()
"""How lists of pieces of a mesh written by agglo begin."""


def piece_name(stem: str, rank: int) -> str:
    """Where the piece of a rank lies beside ``STEM.pvtu``, as ParaView has it."""
    return f"{stem}/{stem}_{rank}.vtu"


def pvtu_list(piece: Piece, sources: Sequence[str]) -> bytes:
    """The list of these files, each of which holds a piece with arrays like those of ``piece``."""
    arrays = list(stored_arrays(piece))
    lines = []
    for section in ("PointData", "CellData", "Points"):
        own = [f"<PDataArray {array.attributes}/>" for array in arrays if array.section == section]
        lines += [f"<P{section}{global_ids(piece, section)}>", *own, f"</P{section}>"]
    lines += [f"<Piece Source={quoteattr(source)}/>" for source in sources]
    ends = "</PUnstructuredGrid>", "</VTKFile>"
    return (_START.format(kind=piece.kind) + "\n".join([*lines, *ends])).encode() + b"\n"
