"""npz, numpy's archive, as a format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from agglo_core.io.format_options import Compressing
from agglo_core.progress import Tell, to_nobody

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh


class Npz(Compressing):
    """npz without pickle: everything a mesh and its hierarchy hold, or polygons in a plain layout.

    Parameters
    ----------
    merge_points : bool
        Merge exactly equal points of the plain layout; a file written by agglo is never changed.
    allow_gaps : bool
        Leave outer faces that lie on one another as they are.
    compress : bool
        Deflate the arrays: smaller files, slower to write and to read.
    drop_flat : bool
        Leave out cells of zero area or volume.

    Examples
    --------
    >>> from pathlib import Path
    >>> from agglo_core.io import Npz
    >>> Npz(compress=True).write(Path("mesh.npz"), agglo.samples.squares(2))
    >>> Npz().read(Path("mesh.npz")).n_cells
    4
    """

    lossless: bool = True
    atomic: bool = True
    tells_progress: bool = True

    def recognises(self, head: bytes) -> bool:
        """Whether a file begins as archives of arrays do."""
        return head.startswith(b"PK\x03\x04") and b".npy" in head

    def read(self, path: Path) -> Mesh:
        """Return the mesh of an archive; raises FileError or MeshError."""
        return self.read_hierarchy(path)[0]

    def read_hierarchy(self, path: Path) -> tuple[Mesh, Hierarchy | None]:
        """Return the mesh and the hierarchy stored with it, if any; raises FileError or MeshError."""
        from agglo_core.io.native.npz import read_npz

        return read_npz(path, **self.reading)

    def write(
        self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None, tell: Tell = to_nobody
    ) -> None:
        """Write mesh and hierarchy; raises FileError."""
        from agglo_core.io.native.npz import write_npz

        write_npz(path, mesh, hierarchy, tell, compress=self.compress)
