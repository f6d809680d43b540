"""PVTU, the list of VTU files that parallel programs write, as a format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agglo_core.mesh import Mesh

__all__ = ["Pvtu"]


class Pvtu:
    """The pieces of a parallel unstructured grid as one mesh, without ghost cells.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points, without which pieces stay apart where they meet.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    """

    suffixes: tuple[str, ...] = (".pvtu",)
    lossless: bool = False

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False) -> None:
        self.merge_points = merge_points
        self.allow_gaps = allow_gaps

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do."""
        return b"<VTKFile" in head and b"PUnstructuredGrid" in head

    def read(self, path: Path) -> Mesh:
        """Return the mesh of all pieces; raises FileError or MeshError."""
        from agglo_core.io.pvtu_read import read_pvtu

        return read_pvtu(path, merge_points=self.merge_points, allow_gaps=self.allow_gaps)
