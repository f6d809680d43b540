"""What is computed of one partition: the value of each metric, errors on it, iterations with it."""

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
from agglo_paper.study.study_partitions import RECIPES

__all__ = ["ERRORS", "SOLVERS", "TOLERANCE", "measured"]

TOLERANCE: Final = 1e-6
SOLVERS: Final[Mapping[str, tuple[str, Mapping[str, Any]]]] = {
    "default": ("polydg_mg", {}),
    "patches": ("polydg_mg", {"recipe": "patches"}),
    "paper": ("polydg_mg_paper", {"operators": "inherited"}),
}
"""Solvers by what the page calls them: name and options. Inherited operators converge for any κ."""
ERRORS: Final = {"L2": "l2", "DG": "dg"}
_DIRECT: Final = ("direct", {"penalty": "sharp", "scaled_basis": True})
_MOST: Final = 500  # iterations, which stand for a solver that has not converged
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
    mesh = _loaded(source)
    labels = RECIPES[recipe].labels(mesh, parts, seed)
    metrics, better = _metrics(mesh, labels)
    outcomes: dict[str, float] = {}
    for degree in degrees:
        outcomes |= _errors(mesh.coarsen(labels), degree)
        for what, problem in _problems(mesh).items():
            for name in SOLVERS:
                outcomes[f"{name} {what} p{degree}"] = _iterations(mesh, labels, name, degree, problem)
    return {"metrics": metrics, "better": better, "outcomes": outcomes}


@lru_cache(maxsize=2)
def _loaded(source: str) -> Mesh:
    """The mesh; units of one mesh follow one another."""
    return load_mesh(source)


def _metrics(mesh: Mesh, labels: Int) -> tuple[dict[str, float], dict[str, str]]:
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


def _unit(mesh: Mesh) -> tuple[Float, float]:
    """Corner and longest side of the box around the mesh."""
    used = mesh.points[mesh.face_vertices]
    low = used.min(axis=0)
    return low, float((used.max(axis=0) - low).max())


def _problems(mesh: Mesh) -> dict[str, Diffusion]:
    """−∇·(κ∇u) = 1 with κ = 1, and with one that jumps between the squares of a chessboard."""
    low, side = _unit(mesh)
    field = np.floor(_SQUARES * (mesh.cell_centroids - low) / side).astype(int).sum(axis=1) % 2
    return {"κ = 1": Diffusion(), "κ jumps": Diffusion(kappa=np.where(field == 1, _CONTRAST, 1.0))}


def _errors(coarse: Mesh, degree: int) -> dict[str, float]:
    """Errors of PolyDG on the mesh of the parts against sin πx sin πy, x and y over the longest side."""
    low, side = _unit(coarse)

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


def _iterations(mesh: Mesh, labels: Int, solver: str, degree: int, problem: Diffusion) -> float:
    """Iterations of two levels until the residual is small enough, the last one in part."""
    name, options = SOLVERS[solver]
    tool = default().build(
        "solver", name, degree=degree, tolerance=TOLERANCE, max_iterations=_MOST, **options
    )
    solution = tool.solve(problem, Hierarchy(mesh, mesh.graph, [labels], [{}], nested=True))
    fallen = np.log(np.maximum(solution.residuals / solution.residuals[0], 1e-300))
    wanted = np.log(TOLERANCE)
    if not (fallen <= wanted).any():
        return float(_MOST)
    last = int(np.argmax(fallen <= wanted))
    return float(last - 1 + (wanted - fallen[last - 1]) / (fallen[last] - fallen[last - 1]))
