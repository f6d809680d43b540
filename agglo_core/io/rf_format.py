"""Polyhedra by their faces, REGN_FACE, as HArDCore3D has them in .node and .ele, as a format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

__all__ = ["RegnFace"]


class RegnFace:
    """Polyhedra as lists of faces in ``NAME.ele``, points in ``NAME.node``: either name stands for both.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    """

    suffixes: tuple[str, ...] = (".ele", ".node")
    lossless: bool = False

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False) -> None:
        self.merge_points = merge_points
        self.allow_gaps = allow_gaps

    def read(self, path: Path) -> Mesh:
        """Return the mesh of both files; raises FileError or MeshError."""
        from agglo_core.io.rf import read_rf

        return read_rf(path, merge_points=self.merge_points, allow_gaps=self.allow_gaps)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write both files, each coarse mesh and the cells of its parts beside; raises an AggloError."""
        from agglo_core.io.rf import write_rf

        write_rf(path, mesh, hierarchy)
