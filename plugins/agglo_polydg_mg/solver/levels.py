"""The levels of the default solver, built as planned."""

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
"""Degree of polynomials on agglomerates in 3-D: levels of full degree take more time than they save."""
_CELLS_PER_PART: Final = 8
_CELLS_PER_LUMP: Final = 27
"""Cells to an agglomerate on the first level of polyhedra of degree 1: seven iterations more than with 8, a
third of the set-up."""
_FEWEST: Final = 60
"""Parts of the coarsest level that is made by default."""


def build(
    plan: Plan, problem: Diffusion, fine: solvers.FineSystem, basis: Basis, labels: Sequence[Int]
) -> Any:
    """Build the levels of a plan, an object of :class:`agglo_core.multigrid.LevelStack`.

    Raises
    ------
    LinAlgError
        If a matrix is not positive definite.
    """
    if plan.recipe != "conforming":
        low = _LOW if basis.mesh.dim == 3 else None
        overlap = plan.recipe == "patches"
        return patch_stack(basis, fine.A, labels, plan.dtype, overlap=overlap, coarse_degree=low)
    assert fine.sigma is not None  # every discretised system has a penalty
    offsets = np.arange(0, fine.A.shape[0] + 1, fine.width)
    system = System.trusted(fine.A, fine.b, offsets, basis.mesh)
    given = (system, basis, fine.sigma, cell_means(basis.mesh, problem.kappa))
    chosen: Any = {
        "labels": labels or None,
        "bubbles": plan.bubbles,
        "vertices": plan.vertices,
        "layers": plan.layers,
        "dtype": plan.dtype,
    }
    if plan.smoother == "cells":
        return conforming_stack(*given, **chosen)
    return grouped_stack(*given, **chosen, overlap=plan.smoother == "patches")


def cells_per_part(plan: Plan, degree: int) -> int:
    """Cells to an agglomerate of the first level, if the levels are made by default."""
    return _CELLS_PER_LUMP if plan.recipe == "agglomerates" and degree == 1 else _CELLS_PER_PART


def levels_by_default(
    hierarchy: Hierarchy, count: int | None = None, first: int = _CELLS_PER_PART
) -> list[Int]:
    """Labels of the levels, finest first: those of the hierarchy, or some made of ``first`` cells to a part.

    Of those made here each has an eighth of the parts of the level before. ``count`` is how many to use, the
    mesh included: of levels made here at most as many as there are.

    Raises
    ------
    OptionError
        If the hierarchy has levels, but fewer than that, or none is coarser than the mesh.
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
