"""Build the multigrid levels of the default solver from its plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Diffusion, Int, System, solvers
from agglo_polydg_mg.auxiliary.conforming_stack import conforming_stack
from agglo_polydg_mg.auxiliary.patch_recipe import patch_stack
from agglo_polydg_mg.forms.coefficients import cell_means, cell_tensors
from agglo_polydg_mg.solver.choose import Plan
from agglo_polydg_mg.space.basis import Basis

_LOW: Final = 1
"""Polynomial degree on agglomerates in 3-D: levels with full degree take more time than they save
(benchmarks/solid_ratios.py --meshes solids --degrees 2)."""
_CELLS_PER_LUMP: Final = 27
"""Cells per agglomerate on the first level of polyhedra at degree 1: seven iterations more than with 8, a
third of the set-up time (benchmarks/solid_ratios.py --meshes solids)."""


def build(
    plan: Plan, problem: Diffusion, fine: solvers.FineSystem, basis: Basis, labels: Sequence[Int]
) -> Any:
    """Build the multigrid levels that a plan describes.

    Returns a :class:`agglo_core.multigrid.LevelStack`.

    Raises
    ------
    LinAlgError
        If a matrix is not positive definite.
    """
    tensors = cell_tensors(basis.mesh, problem.kappa) if plan.directional else None
    # Polynomials on agglomerates
    if plan.recipe != "conforming":
        low = _LOW if basis.mesh.dim == 3 else None
        overlap = plan.recipe == "patches"
        return patch_stack(
            basis, fine.A, labels, plan.dtype, overlap=overlap, coarse_degree=low, tensors=tensors
        )
    # A continuous space and its multigrid
    assert fine.sigma is not None  # every discretised system has a penalty
    offsets = np.arange(0, fine.A.shape[0] + 1, fine.width)
    system = System.trusted(fine.A, fine.b, offsets, basis.mesh)
    return conforming_stack(
        system,
        basis,
        fine.sigma,
        cell_means(basis.mesh, problem.kappa),
        labels=labels or None,
        smoother=plan.smoother,
        bubbles=plan.bubbles,
        vertices=plan.vertices,
        layers=plan.layers,
        dtype=plan.dtype,
        tensors=tensors,
    )


def cells_per_part(plan: Plan, degree: int) -> int:
    """Return the number of cells per agglomerate on the finest level, if the solver makes its own levels."""
    return _CELLS_PER_LUMP if plan.recipe == "agglomerates" and degree == 1 else solvers.CELLS_PER_PART
