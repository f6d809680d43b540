"""Check the face orientations in a file that stores a mesh face by face."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import frozen_int
from agglo_core.errors import FileError
from agglo_core.io.to_mesh.plain_cells import half_faces
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import name_cells
from agglo_core.mesh.construction.shells import TWO_SHELLS, outward_signs
from agglo_core.mesh.elements import take_cells
from agglo_core.mesh.geometry.solid_cells import face_moments


def check_directions(mesh: Mesh) -> None:
    """Raise FileError if a boundary component of a 3-D cell, such as a cavity, is oriented inward.

    The arrays are already checked, so only cells with several shells can be wrong.
    """
    if mesh.dim == 2 or not (np.diff(mesh.cell_faces[0]) >= TWO_SHELLS).any():
        return
    cells = frozen_int(np.flatnonzero(np.diff(mesh.cell_faces[0]) >= TWO_SHELLS))
    solids = take_cells(half_faces(mesh), cells)
    moments = face_moments(mesh.local_points, solids.loop_offsets, solids.vertices)
    cell = frozen_int(np.repeat(np.arange(len(cells)), np.diff(solids.cell_offsets)))
    sign, unsure, _ = outward_signs(
        cell, solids.loop_offsets, solids.vertices, mesh.local_points, *moments, 0.0
    )
    turned = np.setdiff1d(cell[sign < 0], unsure)
    if len(turned):
        raise FileError(
            f"{name_cells(cells[turned])}: the faces of a shell, such as a cavity, are oriented into the cell"
        )
