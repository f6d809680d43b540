"""File format for MATLAB files in the layouts of lymph, mVEM, PolyMesher and MRST."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.io.matlab.read import read_matlab
from agglo_core.io.matlab.write import write_matlab
from agglo_core.io.to_mesh.options import Compressing
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy


class Matlab(Compressing):
    """MATLAB files with the variable ``region`` of lymph, or ``node`` and ``elem`` of mVEM.

    Both are written.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points on reading.
    allow_gaps : bool
        Keep coincident outer faces.
    compress : bool
        Deflate the variables, as ``save -v7`` does: smaller files, slower to write and to read.
    drop_flat : bool
        Drop cells with zero area or volume.
    """

    lossless: bool = False

    def read(self, path: Path) -> Mesh:
        """Read the mesh in a MATLAB file.

        Files of other programs do not declare their variables: one that is truncated between two variables
        lacks the others.

        Raises FileError or MeshError.
        """
        return read_matlab(path, **self.reading)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write the mesh, its tags and labels, and each coarse mesh to a file beside it.

        Raises an AggloError.
        """
        write_matlab(path, mesh, hierarchy, compress=self.compress)
