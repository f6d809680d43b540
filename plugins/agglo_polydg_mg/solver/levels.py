"""Build the multigrid levels of the default solver from its plan."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Diffusion, Hierarchy, Int, System, solvers
from agglo_polydg_mg.auxiliary.conforming_stack import conforming_stack
from agglo_polydg_mg.auxiliary.grouped_stack import grouped_stack
from agglo_polydg_mg.auxiliary.patch_recipe import patch_stack
from agglo_polydg_mg.forms.assembly import cell_means
from agglo_polydg_mg.solver.choose import Plan
from agglo_polydg_mg.space.basis import Basis

_LOW: Final = 1
"""Polynomial degree on agglomerates in 3-D: levels with full degree take more time than they save
(benchmarks/solid_ratios.py --meshes solids --degrees 2)."""
_CELLS_PER_PART: Final = 8
"""Cells per agglomerate on the first default level, and agglomerates per agglomerate of the next. A larger
value makes the set-up cheaper and takes more iterations (benchmarks/solid_ratios.py --meshes solids)."""
_CELLS_PER_LUMP: Final = 27
"""Cells per agglomerate on the first level of polyhedra at degree 1: seven iterations more than with 8, a
third of the set-up time (benchmarks/solid_ratios.py --meshes solids)."""
_FEWEST: Final = 60
"""Smallest number of parts of the coarsest default level. A larger value leaves a larger system to the direct
solver, a smaller value adds levels (benchmarks/solid_ratios.py --meshes solids)."""


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
    # Polynomials on agglomerates
    if plan.recipe != "conforming":
        low = _LOW if basis.mesh.dim == 3 else None
        overlap = plan.recipe == "patches"
        return patch_stack(basis, fine.A, labels, plan.dtype, overlap=overlap, coarse_degree=low)
    # A continuous space and its multigrid
    assert fine.sigma is not None  # every discretised system has a penalty
    offsets = np.arange(0, fine.A.shape[0] + 1, fine.width)
    system = System.trusted(fine.A, fine.b, offsets, basis.mesh)
    arguments = (system, basis, fine.sigma, cell_means(basis.mesh, problem.kappa))
    options: Any = {
        "labels": labels or None,
        "bubbles": plan.bubbles,
        "vertices": plan.vertices,
        "layers": plan.layers,
        "dtype": plan.dtype,
    }
    if plan.smoother == "cells":
        return conforming_stack(*arguments, **options)
    return grouped_stack(*arguments, **options, overlap=plan.smoother == "patches")


def cells_per_part(plan: Plan, degree: int) -> int:
    """Return the number of cells per agglomerate on the finest level, if the solver makes its own levels."""
    return _CELLS_PER_LUMP if plan.recipe == "agglomerates" and degree == 1 else _CELLS_PER_PART


def levels_by_default(
    hierarchy: Hierarchy, count: int | None = None, first: int = _CELLS_PER_PART
) -> list[Int]:
    """Return the labels of the hierarchy's levels, finest first, or of default levels if it has none.

    The hierarchy's levels are used if there are any. Otherwise levels are made with ``first``
    cells per part and, from level to level, an eighth of the parts. ``count`` limits the number of
    levels, the mesh included; default levels may be fewer.

    Raises
    ------
    OptionError
        If the hierarchy has levels, but fewer than ``count``, or none is coarser than the mesh.
    """
    if hierarchy.levels:
        return solvers.chosen_levels(hierarchy, count)
    n = hierarchy.graph.n
    sizes = []
    while n // (first * _CELLS_PER_PART ** len(sizes)) >= _FEWEST:
        sizes.append(first * _CELLS_PER_PART ** len(sizes))
    sizes = sizes[: None if count is None else count - 1]
    if not sizes:
        return []
    from agglo_core.authoring import agglomerate

    given = hierarchy.fine if hierarchy.fine is not None else hierarchy.graph
    straight = agglomerate(
        given, bisector="coordinate", refiners=(), polish=False, cells_per_part=tuple(sizes)
    )
    return list(straight.levels)
