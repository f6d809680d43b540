"""Coefficients, boundary data, quadrature and point location on meshes, for discretisations."""

from agglo_core.fields.boundary import BoundaryParts, boundary_parts, boundary_values
from agglo_core.fields.coefficients import is_zero, nonnegative, positive
from agglo_core.fields.gauss_points import gauss, simplex_rule
from agglo_core.fields.location import locate
from agglo_core.fields.rules import Batch, inside
from agglo_core.fields.sampling import sample_points
from agglo_core.fields.simplices import triangles_of_faces
from agglo_core.fields.tensors import Tensor
from agglo_core.fields.values import per_cell, sample

__all__ = [
    "Batch",
    "BoundaryParts",
    "Tensor",
    "boundary_parts",
    "boundary_values",
    "gauss",
    "inside",
    "is_zero",
    "locate",
    "nonnegative",
    "per_cell",
    "positive",
    "sample",
    "sample_points",
    "simplex_rule",
    "triangles_of_faces",
]
