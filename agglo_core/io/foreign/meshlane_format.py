"""Every other format, through the package meshlane, which is asked after those of agglo and of plugins."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.io.format_options import Reading

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh


class Meshlane(Reading):
    """The files that the package meshlane reads and writes: Abaqus, STL, MED and more.

    Gmsh's files, and unstructured grids and PolyData of legacy VTK, are read by agglo itself.
    What is written is read back and compared; what the file would lose is refused.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    drop_flat : bool
        Leave out cells of zero area or volume.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.io import Meshlane
    >>> Meshlane().write(Path("mesh.vtk"), agglo.samples.squares(2))
    >>> Meshlane().read(Path("mesh.vtk")).n_cells
    4
    """

    lossless: bool = False
    atomic: bool = True
    last_resort: bool = True

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.foreign.meshlane_read import read_foreign

        return read_foreign(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write the mesh and the labels of its levels; raises FileError or MeshError."""
        from agglo_core.io.foreign.meshlane_write import write_foreign

        write_foreign(path, mesh, hierarchy)
