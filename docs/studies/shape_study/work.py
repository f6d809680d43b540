"""Measure one partition: metrics, errors, iterations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np

from agglo_core.authoring import (
    OBJECTIVES,
    AggloError,
    Diffusion,
    Float,
    Hierarchy,
    Int,
    Mesh,
    default,
    load_mesh,
    quality,
)
from shape_study.partitions import RECIPES

TOLERANCE: Final = 1e-6
SOLVERS: Final[Mapping[str, tuple[str, Mapping[str, Any]]]] = {
    "default": ("polydg_mg", {}),
    "patches": ("polydg_mg", {"recipe": "patches"}),
    "paper": ("polydg_mg_paper", {"operators": "inherited"}),
}
"""Solvers by what the page calls them: name and options. Inherited operators converge for any κ."""
ERRORS: Final = {"L2": "l2", "DG": "dg"}
_DIRECT: Final = ("direct", {"penalty": "sharp", "scaled_basis": True})
MOST: Final = 500  # iterations, which stand for a solver that has not converged
_CONTRAST: Final = 1e3
_SQUARES: Final = 5  # of equal κ along each side; no multiple of two: halvings would meet their borders
_NONE: Final = ("cells", "components", "diameter_ratio")  # alike in all, or in need of a size


def measured(
    source: str, parts: int, recipe: str, seed: int, degrees: Sequence[int]
) -> dict[str, dict[str, Any]]:
    """Metrics and outcomes of a partition by name: plain data.

    ``metrics`` are means over the parts, and objectives of the whole; ``better`` says which way. ``outcomes``
    are iterations, with a fraction, by solver, degree and coefficient, and the errors on the coarse mesh.
    """
    mesh = loaded(source)
    labels = RECIPES[recipe].labels(mesh, parts, seed)
    metrics, better = metrics_of(mesh, labels)
    outcomes: dict[str, float] = {}
    for degree in degrees:
        outcomes |= _errors(mesh.coarsen(labels), degree)
        for what, problem in problems(mesh).items():
            for name in SOLVERS:
                tool = plane_solver(name, degree)
                outcomes[f"{name} {what} p{degree}"] = iterations(mesh, [labels], tool, problem)
    return {"metrics": metrics, "better": better, "outcomes": outcomes}


@lru_cache(maxsize=2)
def loaded(source: str) -> Mesh:
    """The mesh; units of one mesh follow one another."""
    return load_mesh(source)


def metrics_of(mesh: Mesh, labels: Int) -> tuple[dict[str, float], dict[str, str]]:
    """Means of all metrics and values of all objectives, and which way each is better."""
    values: dict[str, float] = {}
    better: dict[str, str] = {}
    for record in default().list():
        if record.kind != "metric" or record.state != "ok" or record.name in _NONE:
            continue
        try:
            metric = default().build("metric", record.name)
            found = quality(mesh, labels, [record.name])[record.name]
        except AggloError:
            continue  # it needs options, or does not exist for such a mesh
        values[record.name], better[record.name] = float(np.nanmean(found)), metric.better
    for name, objective in OBJECTIVES.items():
        values[name], better[name] = float(objective.value(mesh.graph, labels)), "low"
    return values, better


def unit_box(mesh: Mesh) -> tuple[Float, float]:
    """Corner and longest side of the box around the mesh."""
    used = mesh.points[mesh.face_vertices]
    low = used.min(axis=0)
    return low, float((used.max(axis=0) - low).max())


def coefficients(mesh: Mesh) -> dict[str, Float]:
    """κ of each cell: 1, and one that jumps between the squares of a chessboard."""
    low, side = unit_box(mesh)
    field = np.floor(_SQUARES * (mesh.cell_centroids - low) / side).astype(int).sum(axis=1) % 2
    return {"κ = 1": np.ones(mesh.n_cells), "κ jumps": np.where(field == 1, _CONTRAST, 1.0)}


def _errors(coarse: Mesh, degree: int) -> dict[str, float]:
    """Errors of PolyDG on the mesh of the parts against sin πx sin πy, x and y over the longest side."""
    low, side = unit_box(coarse)

    def exact(points: Float) -> Float:
        sines: Float = np.sin(np.pi * (points - low) / side).prod(axis=1)
        return sines

    problem = Diffusion(
        source=lambda points: 2 * (np.pi / side) ** 2 * exact(points), dirichlet={0: exact}, exact=exact
    )
    name, options = _DIRECT
    solver = default().build("solver", name, degree=degree, **options)
    bare = Mesh(coarse.points, coarse.face_offsets, coarse.face_vertices, coarse.face_cells)
    one = Hierarchy(bare, bare.graph, [np.zeros(bare.n_cells, np.int64)], [{}], nested=True)
    x = solver.solve(problem, one).x
    found = solver.discretisation.errors(problem, bare, x)
    return {f"{word} p{degree}": found[key] for word, key in ERRORS.items()}


def problems(mesh: Mesh) -> dict[str, Diffusion]:
    """−∇·(κ∇u) = 1 with each of the coefficients."""
    constant, jumping = coefficients(mesh).items()
    return {constant[0]: Diffusion(), jumping[0]: Diffusion(kappa=jumping[1])}


def plane_solver(name: str, degree: int) -> Any:
    """One of :data:`SOLVERS`."""
    kind, options = SOLVERS[name]
    limits = {"tolerance": TOLERANCE, "max_iterations": MOST}
    return default().build("solver", kind, degree=degree, **limits, **options)


def iterations(mesh: Mesh, levels: Sequence[Int], tool: Any, problem: Any) -> float:
    """Iterations of a solver with levels until the residual is small enough, the last one in part."""
    targets: list[dict[str, Any]] = [{} for _ in levels]
    solution = tool.solve(problem, Hierarchy(mesh, mesh.graph, list(levels), targets, nested=True))
    fallen = np.log(np.maximum(solution.residuals / solution.residuals[0], 1e-300))
    wanted = np.log(TOLERANCE)
    if not (fallen <= wanted).any():
        return float(MOST)
    last = int(np.argmax(fallen <= wanted))
    return float(last - 1 + (wanted - fallen[last - 1]) / (fallen[last] - fallen[last - 1]))
