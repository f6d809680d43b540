"""Measure levels of partitions of a 3-D mesh, with finite volumes.

Finite volumes take its place: one unknown in each cell, two-point fluxes. With them errors of the parts are
no measure of shapes, as two points say too little about faces that are not at right angles to the line
between them; how well linear functions on the parts come up to a smooth function stands for errors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Linear, Mesh, default, frozen_float, frozen_int
from shape_study.levels import Kind, metrics_of_levels, target_of
from shape_study.partitions import RECIPES
from shape_study.work import MOST, TOLERANCE, coefficients, iterations, loaded, unit_box

SOLID_SOLVERS: Final[Mapping[str, tuple[str, Mapping[str, Any]]]] = {
    "default": ("polydg_mg", {"recipe": "agglomerates"}),
    "smoothed": ("multigrid", {}),
    "constants": ("multigrid", {"transfer": "injection"}),
    "paper": ("polydg_mg_paper", {"operators": "inherited"}),
}
"""Solvers by what the page calls them: name and options."""
APPROXIMATION: Final = "approximation"


def finite_volumes(mesh: Mesh, kappa: Float) -> Linear:
    """−∇·(κ∇u) = 1 with u = 0 on the boundary, κ ``(n_cells,)`` constant in each cell."""
    centres, (own, other) = mesh.cell_centroids, mesh.face_cells.T
    inside = other >= 0
    corners = mesh.points[mesh.face_vertices[mesh.face_offsets[:-1]]]
    height = np.abs(((corners - centres[own]) * mesh.face_normals).sum(axis=1))
    apart = np.linalg.norm(centres[other] - centres[own], axis=1)
    means = 2.0 * kappa[own] * kappa[other] / (kappa[own] + kappa[other])
    fluxes = mesh.face_measures * np.where(inside, means, kappa[own]) / np.where(inside, apart, height)
    i, j, between = own[inside], other[inside], fluxes[inside]
    diagonal = np.bincount(own, fluxes, mesh.n_cells) + np.bincount(j, between, mesh.n_cells)
    links = sparse.coo_array((between, (i, j)), shape=(mesh.n_cells, mesh.n_cells))
    A = sparse.csr_array(sparse.diags_array(diagonal) - links - links.T)
    return Linear(A, mesh.cell_measures, frozen_int(np.arange(mesh.n_cells + 1)))


def approximation_error(mesh: Mesh, labels: Int) -> float:
    """Least error in L2 of a linear function on each part against the product of sines of the coordinates.

    In the middle of the cells, by their measures, over the norm of that product.
    """
    low, side = unit_box(mesh)
    values = np.sin(np.pi * (mesh.cell_centroids - low) / side).prod(axis=1)
    total = 0.0
    order = np.argsort(labels, kind="stable")
    for cells in np.split(order, np.cumsum(np.bincount(labels))[:-1]):
        weights, centres = np.sqrt(mesh.cell_measures[cells]), mesh.cell_centroids[cells]
        basis = np.column_stack([np.ones(len(cells)), (centres - centres.mean(axis=0)) / side])
        weighted, wanted = weights[:, None] * basis, weights * values[cells]
        fitted = np.linalg.lstsq(weighted, wanted, rcond=None)[0]
        total += float(((weighted @ fitted - wanted) ** 2).sum())
    return float(np.sqrt(total / (mesh.cell_measures * values**2).sum()))


def measured_solids(
    source: str, kind: Kind, per_part: Sequence[int], recipe: str, seed: int
) -> dict[str, dict[str, Any]]:
    """Metrics and outcomes of levels by name, plain data as of :func:`shape_study.work.measured`.

    Outcomes are iterations with all levels, the error of approximation by the finest, and by size the number
    of ``parts``.
    """
    mesh = loaded(source)
    target = target_of(mesh, kind, per_part)
    levels = RECIPES[recipe].levels(mesh, target, seed)
    metrics, better = metrics_of_levels(mesh, levels, target)
    outcomes = {"parts": metrics["parts"]} if kind == "sizes" else {}
    outcomes[APPROXIMATION] = approximation_error(mesh, levels[0])
    for what, kappa in coefficients(mesh).items():
        problem = finite_volumes(mesh, frozen_float(kappa))
        for name, (solver, options) in SOLID_SOLVERS.items():
            limits = {"tolerance": TOLERANCE, "max_iterations": MOST}
            tool = default().build("solver", solver, **limits, **options)
            outcomes[f"{name} {what}"] = iterations(mesh, levels, tool, problem)
    return {"metrics": metrics, "better": better, "outcomes": outcomes}
