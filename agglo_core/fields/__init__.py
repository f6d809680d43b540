"""Coefficients, boundary data, quadrature and point location on meshes, for discretisations."""

from agglo_core.fields.assembly import fix_unknowns, sum_blocks
from agglo_core.fields.boundary import (
    BoundaryParts,
    boundary_parts,
    boundary_values,
    natural_values,
    require_exact,
    robin_alpha,
)
from agglo_core.fields.coefficients import is_zero, nonnegative, positive
from agglo_core.fields.corrections import corrections
from agglo_core.fields.errors import error_norms
from agglo_core.fields.floating import Floating, magnitude
from agglo_core.fields.gauss_points import gauss, simplex_rule
from agglo_core.fields.location import locate
from agglo_core.fields.polynomials import AtPoints, Polynomials
from agglo_core.fields.residuals import CellResiduals, cell_residuals, kappa_values, reach_of, times
from agglo_core.fields.rules import Batch, inside
from agglo_core.fields.sampling import sample_points
from agglo_core.fields.simplices import triangles_of_faces
from agglo_core.fields.tensors import Tensor
from agglo_core.fields.values import per_cell, sample

__all__ = [
    "AtPoints",
    "Batch",
    "BoundaryParts",
    "CellResiduals",
    "Floating",
    "Polynomials",
    "Tensor",
    "boundary_parts",
    "boundary_values",
    "cell_residuals",
    "corrections",
    "error_norms",
    "fix_unknowns",
    "gauss",
    "inside",
    "is_zero",
    "kappa_values",
    "locate",
    "magnitude",
    "natural_values",
    "nonnegative",
    "per_cell",
    "positive",
    "reach_of",
    "require_exact",
    "robin_alpha",
    "sample",
    "sample_points",
    "simplex_rule",
    "sum_blocks",
    "times",
    "triangles_of_faces",
]
