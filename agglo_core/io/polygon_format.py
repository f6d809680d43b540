"""Plane polygons in .off and .obj, files of geometry processing, as formats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

__all__ = ["Obj", "Off"]


class Off:
    """OFF: points and polygons; a constant z makes a plane mesh, surfaces are refused.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    """

    suffixes: tuple[str, ...] = (".off",)
    lossless: bool = False

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False) -> None:
        self.merge_points = merge_points
        self.allow_gaps = allow_gaps

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do."""
        return head.split(maxsplit=1)[:1] == [b"OFF"]

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.polygon_files import read_off

        return read_off(path, merge_points=self.merge_points, allow_gaps=self.allow_gaps)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a plane mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.polygon_files import write_off

        write_off(path, mesh, hierarchy)


class Obj:
    """Wavefront OBJ: points and polygons; a constant z makes a plane mesh, surfaces are refused.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    """

    suffixes: tuple[str, ...] = (".obj",)
    lossless: bool = False

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False) -> None:
        self.merge_points = merge_points
        self.allow_gaps = allow_gaps

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.polygon_files import read_obj

        return read_obj(path, merge_points=self.merge_points, allow_gaps=self.allow_gaps)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a plane mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.polygon_files import write_obj

        write_obj(path, mesh, hierarchy)
