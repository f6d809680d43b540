"""The recipes of the default solver: which levels precondition a system, and why these."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from agglo_core.authoring import Diffusion, Float, Hierarchy, Int, OptionError, System, solvers
from agglo_polydg_mg.auxiliary.conforming_stack import conforming_stack
from agglo_polydg_mg.auxiliary.grouped_stack import grouped_stack
from agglo_polydg_mg.auxiliary.patch_recipe import patch_stack
from agglo_polydg_mg.forms.assembly import cell_means
from agglo_polydg_mg.solver.conforming_choice import difficulty
from agglo_polydg_mg.space.basis import Basis

RECIPES: Final = ("auto", "conforming", "patches", "agglomerates")
CYCLES: Final = ("auto", "V", "W", "F", "K")
PRECISIONS: Final = ("auto", "single", "double")

_FINE: Final = (1e-33, 1e35)
"""Entries of the diagonal that single precision holds with room for products and sums."""
_LOW: Final = 1
"""Degree of polynomials on agglomerates in space: levels of full degree take more time than they save."""
_CELLS_PER_PART: Final = 8
_CELLS_PER_LUMP: Final = 27
"""The same on the first level of polyhedra of degree 1: seven iterations more, a third of the set-up."""
_FEWEST: Final = 60
"""Parts of the coarsest level that is made by default."""


@dataclass(frozen=True)
class Wishes:
    """What the user fixes; the rest is ``"auto"``."""

    recipe: str = "auto"
    cycle: str = "auto"
    precision: str = "auto"


@dataclass(frozen=True)
class Plan:
    """How the levels of a system are to be made; ``reason`` says it in words."""

    recipe: Literal["conforming", "patches", "agglomerates"]
    cycle: Literal["V", "W", "F", "K"]
    dtype: Any
    smoother: Literal["cells", "groups", "patches"]
    bubbles: bool
    vertices: Literal["aggregates", "classical"]
    layers: bool
    reason: str
    solid: bool = False

    @property
    def kind(self) -> solvers.Kind:
        """Of system, as advice knows them."""
        if self.solid:
            return "solids"
        return "cells" if self.smoother == "cells" and self.bubbles else "groups"

    def cells_per_part(self, degree: int) -> int:
        """Cells to an agglomerate of the first level, if the levels are made by default."""
        return _CELLS_PER_LUMP if self.recipe == "agglomerates" and degree == 1 else _CELLS_PER_PART

    def stack(self, problem: Diffusion, fine: solvers.FineSystem, basis: Basis, labels: Sequence[Int]) -> Any:
        """The levels, an object of :class:`agglo_core.multigrid.LevelStack`.

        Raises
        ------
        LinAlgError
            If a matrix is not positive definite.
        """
        if self.recipe != "conforming":
            low = _LOW if self.solid else None
            overlap = self.recipe == "patches"
            return patch_stack(basis, fine.A, labels, self.dtype, overlap=overlap, coarse_degree=low)
        offsets = np.arange(0, fine.A.shape[0] + 1, fine.width)
        system = System.trusted(fine.A, fine.b, offsets, basis.mesh)
        given = (system, basis, _required(fine.sigma), cell_means(basis.mesh, problem.kappa))
        chosen: Any = {
            "labels": labels or None,
            "bubbles": self.bubbles,
            "vertices": self.vertices,
            "layers": self.layers,
            "dtype": self.dtype,
        }
        if self.smoother == "cells":
            return conforming_stack(*given, **chosen)
        return grouped_stack(*given, **chosen, overlap=self.smoother == "patches")


def plan_for(problem: Diffusion, fine: solvers.FineSystem, basis: Basis, wishes: Wishes) -> Plan:
    """The plan for a diffusion problem, by mesh, penalty and coefficient.

    See :func:`~agglo_polydg_mg.solver.conforming_choice.difficulty`.

    Raises
    ------
    OptionError
        For the recipe ``"agglomerates"`` in the plane.
    """
    solid = basis.mesh.dim == 3
    if wishes.recipe == "agglomerates" and not solid:
        raise OptionError("recipe 'agglomerates' is for linear systems; a diffusion problem takes another")
    double = {"auto": None, "single": False, "double": True}[wishes.precision]
    found = difficulty(basis.mesh, _required(fine.sigma), cell_means(basis.mesh, problem.kappa), basis.degree)
    recipe: Any = found.recipe if wishes.recipe == "auto" else wishes.recipe
    by_default = "W" if recipe == "patches" else found.kind
    kind: Any = by_default if wishes.cycle == "auto" else wishes.cycle
    sizes = fine.A.diagonal()
    far = not (sizes.min() > _FINE[0] and sizes.max() < _FINE[1])
    by_itself = np.float64 if far else found.dtype
    dtype = by_itself if double is None else (np.float64 if double else np.float32)
    smoother: Any = {"patches": "patches", "agglomerates": "cells"}.get(recipe, found.smoother)
    below = "its aggregates" if found.vertices == "aggregates" else "classical levels"
    space = f"continuous space and {below}" if recipe == "conforming" else "smoothed agglomerates"
    reason = f"{space}, {smoother}, {kind}-cycle, {np.dtype(dtype).name} ({found.reason})"
    return Plan(recipe, kind, dtype, smoother, found.bubbles, found.vertices, found.layers, reason, solid)


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


def _required(sigma: Float | None) -> Float:
    assert sigma is not None  # every discretised system has one
    return sigma
