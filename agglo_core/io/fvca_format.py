"""The files of the FVCA benchmarks, .typ1 and .typ2, as a format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

__all__ = ["Fvca"]


class Fvca:
    """Plane meshes of the FVCA benchmarks, as HArDCore2D and DISK++ read them; written as ``.typ2``.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    """

    suffixes: tuple[str, ...] = (".typ2", ".typ1")
    lossless: bool = False

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False) -> None:
        self.merge_points = merge_points
        self.allow_gaps = allow_gaps

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do: with the title of the points."""
        return head.lstrip()[:8].lower() == b"vertices"

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.fvca import read_fvca

        return read_fvca(path, merge_points=self.merge_points, allow_gaps=self.allow_gaps)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a plane mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.fvca import write_typ2

        write_typ2(path, mesh, hierarchy)
