"""VTKHDF, ParaView's grids in HDF5, as a format; it needs h5py."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.io.format_options import Compressing
from agglo_core.progress import Tell, to_nobody

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.io.level_values import LevelValues
    from agglo_core.mesh import Mesh


class VtkHdf(Compressing):
    """Unstructured grids of VTKHDF: any mesh, its tags and the labels of all levels, as in ``.vtu``."""

    lossless: bool = False
    atomic: bool = True
    tells_progress: bool = True
    keeps_level_values: bool = True

    def read(self, path: Path) -> Mesh:
        """Return the mesh of a file; raises FileError or MeshError."""
        from agglo_core.io.vtk.hdf_read import read_vtkhdf

        return read_vtkhdf(path, **self.reading)

    def write(
        self,
        path: Path,
        mesh: Mesh,
        hierarchy: Hierarchy | None = None,
        level_values: LevelValues | None = None,
        tell: Tell = to_nobody,
    ) -> None:
        """Write the mesh, and each coarse mesh with its values beside it; raises an AggloError."""
        from agglo_core.io.vtk.hdf_write import write_vtkhdf

        write_vtkhdf(path, mesh, hierarchy, level_values, tell, compress=self.compress)
