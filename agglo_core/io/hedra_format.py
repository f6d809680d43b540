"""cinolib's .hedra, polyhedra with faces of their own, as a format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

__all__ = ["Hedra"]


class Hedra:
    """Points, faces, and polyhedra as lists of faces, negative where a face is seen from inside.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    """

    suffixes: tuple[str, ...] = (".hedra",)
    lossless: bool = False

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False) -> None:
        self.merge_points = merge_points
        self.allow_gaps = allow_gaps

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.hedra import read_hedra

        return read_hedra(path, merge_points=self.merge_points, allow_gaps=self.allow_gaps)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a solid mesh, its tags and labels, and each coarse mesh beside it; raises an AggloError."""
        from agglo_core.io.hedra import write_hedra

        write_hedra(path, mesh, hierarchy)
