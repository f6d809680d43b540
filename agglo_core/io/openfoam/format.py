"""File format for OpenFOAM cases, which are folders, often marked by an empty file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.io.openfoam.read import is_foam_folder, read_foam
from agglo_core.io.openfoam.write import write_foam
from agglo_core.io.to_mesh.options import Compressing
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy


class OpenFoam(Compressing):
    """OpenFOAM cases: ``constant/polyMesh`` beside a file or in a folder.

    Levels are written as a decomposition for decomposePar and as fields.

    Parameters
    ----------
    merge_points : bool
        Merge coincident points of outer faces on reading.
    allow_gaps : bool
        Keep coincident outer faces.
    compress : bool
        Write gzipped files.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.io import OpenFoam
    >>> OpenFoam().write(Path("case.foam"), agglo.samples.boxes(2))
    >>> OpenFoam().read(Path("case.foam")).n_cells
    8
    """

    lossless: bool = False
    reads_empty: bool = True
    atomic: bool = True
    folders: tuple[str, ...] = ("constant", "0")

    def __init__(self, merge_points: bool = True, allow_gaps: bool = False, compress: bool = False) -> None:
        super().__init__(merge_points, allow_gaps, compress)

    def recognises_folder(self, folder: Path) -> bool:
        """Return True for the folder of a case and for its subfolders ``constant`` and ``polyMesh``."""
        return is_foam_folder(folder)

    def read(self, path: Path) -> Mesh:
        """Read the mesh of an OpenFOAM case.

        Raises FileError or MeshError.
        """
        return read_foam(path, merge_points=self.merge_points, allow_gaps=self.allow_gaps)

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        """Write a 3-D mesh and the labels of its levels as an OpenFOAM case.

        Raises an AggloError.
        """
        write_foam(path, mesh, hierarchy, compress=self.compress)
