"""Convert meshes to pyvista, as the same grid that ParaView shows for agglo's files."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from agglo_core.arrays import trusted_copy
from agglo_core.errors import OptionError
from agglo_core.io.levels import check_belongs
from agglo_core.io.tags import cell_data
from agglo_core.io.vtk.vtu import Vtu
from agglo_core.mesh import Mesh

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy


def to_pyvista(mesh: Mesh, hierarchy: Hierarchy | None = None) -> Any:
    """Convert a mesh to a ``pyvista.UnstructuredGrid`` with cells in the same order.

    Cells that are exactly VTK elements become these, others polygons or polyhedra.

    Cell data are the cell tags and, with a hierarchy, the labels ``level_0``, ``level_1``, …. The conversion
    uses a VTU file in a temporary folder, so the grid is the one that ParaView opens: a cell with holes is a
    polygon with bridges, which VTK does not fill; colour the fine mesh by ``level_i`` instead.

    Raises
    ------
    OptionError
        If pyvista is not installed.
    MeshError
        If the hierarchy belongs to another mesh, or VTU cannot hold a tag name.

    Examples
    --------
    >>> from agglo_core.interchange import to_pyvista
    >>> to_pyvista(agglo.samples.squares(2)).n_cells  # doctest: +SKIP
    4
    """
    try:
        import pyvista
    except ImportError as error:
        raise OptionError(f"to_pyvista needs pyvista: pip install pyvista ({error})") from error
    if hierarchy is not None:
        check_belongs(mesh, hierarchy)
    with TemporaryDirectory(prefix="agglo") as folder:
        path = Path(folder) / "mesh.vtu"
        Vtu().write(path, trusted_copy(mesh, cell_tags=cell_data(mesh, hierarchy), face_tags={}))
        return pyvista.read(path)
