"""Polytopal meshes: construction, checks, geometry.

A mesh consists of points, faces and the two cells at each face.
"""

from agglo_core.mesh.checks import box_centre, check_labels
from agglo_core.mesh.geometry.diameters import compared_diameters, diameters_of, wide_parts
from agglo_core.mesh.geometry.loops import Loops
from agglo_core.mesh.polytopal import Mesh
from agglo_core.mesh.simplify.record import Simplification

__all__ = [
    "Loops",
    "Mesh",
    "Simplification",
    "box_centre",
    "check_labels",
    "compared_diameters",
    "diameters_of",
    "wide_parts",
]
