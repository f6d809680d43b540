"""Conversion of DOLFINx meshes to agglo meshes, and of cell labels to DOLFINx.

Each process has its own cells; they are converted without ghosts, in DOLFINx numbering.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.authoring import Mesh, OptionError

_POLYGONS: Final = {"triangle": (0, 1, 2), "quadrilateral": (0, 1, 3, 2)}
"""Cell corners in cyclic order; DOLFINx uses tensor-product order."""
_FACES: Final = {
    "tetrahedron": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    "hexahedron": (
        (0, 2, 3, 1),
        (4, 5, 7, 6),
        (0, 1, 5, 4),
        (2, 6, 7, 3),
        (0, 4, 6, 2),
        (1, 3, 7, 5),
    ),
}
"""Corners of each cell face."""


def from_dolfinx(domain: Any) -> Mesh:
    """Convert the cells of a ``dolfinx.mesh.Mesh`` owned by this process, with unchanged cell numbers.

    Parameters
    ----------
    domain : dolfinx.mesh.Mesh
        Triangles or quadrilaterals in 2-D, tetrahedra or hexahedra in 3-D; curved cells are represented by
        their corners.

    Raises
    ------
    OptionError
        For other cells, or a surface in 3-D.
    MeshError
        If this process owns no cells.
    """
    # 1. Check the cell type
    kind, dim = domain.topology.cell_name(), domain.geometry.dim
    if dim != domain.topology.dim or kind not in {**_POLYGONS, **_FACES}:
        raise OptionError(
            f"cells are {kind} in {dim}-D; expected triangles or quadrilaterals in 2-D, tetrahedra or "
            "hexahedra in 3-D"
        )
    # 2. Corners of the own cells
    count = domain.topology.index_map(domain.topology.dim).size_local
    tables = domain.geometry.dofmaps  # a method before DOLFINx 0.11
    corners = (tables(0) if callable(tables) else tables[0])[:count, : _CORNERS[kind]]
    used, cells = np.unique(corners, return_inverse=True)
    points, cells = domain.geometry.x[used, :dim], cells.reshape(corners.shape)
    # 3. Polygons, or polyhedra with oriented faces
    if kind in _POLYGONS:
        return Mesh.from_polygons(points, cells[:, _POLYGONS[kind]])
    faces = np.array(_FACES[kind])
    loops = np.arange(count * len(faces) + 1) * faces.shape[1]
    return Mesh.from_polyhedra(points, (np.arange(count + 1) * len(faces), loops, cells[:, faces].ravel()))


# Number of corners of a cell, which are its first nodes.
_CORNERS: Final = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}


def to_dolfinx(domain: Any, labels: ArrayLike) -> Any:
    """Convert the labels of the cells owned by this process to ``dolfinx.mesh.MeshTags``.

    Parameters
    ----------
    domain : dolfinx.mesh.Mesh
    labels : (own cells,) int
        For example a hierarchy level on the mesh from :func:`from_dolfinx`.

    Raises
    ------
    OptionError
        If there is not one whole number for each cell.
    """
    from dolfinx.mesh import meshtags

    tdim = domain.topology.dim
    count, values = domain.topology.index_map(tdim).size_local, np.asarray(labels)
    if values.shape != (count,) or values.dtype.kind not in "iu":
        raise OptionError(
            f"labels must be {count} whole numbers, one for each cell of this rank; given {labels!r:.60}"
        )
    found = meshtags(domain, tdim, np.arange(count, dtype=np.int32), values.astype(np.int32))
    found.name = "parts"
    return found
