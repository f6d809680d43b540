"""VTU, the XML files of unstructured grids that ParaView opens, as a format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.io.format_options import Compressing
from agglo_core.progress import Tell, to_nobody

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io.level_values import LevelValues
    from agglo_core.mesh import Mesh


class Vtu(Compressing):
    """VTU by agglo's own reader and writer: any mesh, its cell tags, the labels of all levels.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    compress : bool
        Write zlib of the arrays: smaller files, slower to write and to read.
    drop_flat : bool
        Leave out cells of zero area or volume.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.io import Vtu
    >>> Vtu().write(Path("mesh.vtu"), agglo.samples.squares(2))
    >>> Vtu().read(Path("mesh.vtu")).n_cells
    4
    """

    lossless: bool = False
    atomic: bool = True
    tells_progress: bool = True
    keeps_level_values: bool = True

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as these do."""
        return b"<VTKFile" in head and b"UnstructuredGrid" in head and b"PUnstructuredGrid" not in head

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a VTU file; raises FileError or MeshError."""
        from agglo_core.io.vtk.vtu_read import read_vtu

        return read_vtu(path, **self.reading)

    def write(
        self,
        path: Path,
        mesh: Mesh,
        hierarchy: Hierarchy | None = None,
        level_values: LevelValues | None = None,
        tell: Tell = to_nobody,
    ) -> None:
        """Write the mesh, and each coarse mesh with its values beside it; raises an AggloError."""
        from agglo_core.io.vtk.vtu_write import write_vtu

        write_vtu(path, mesh, hierarchy, level_values, tell, compress=self.compress)
