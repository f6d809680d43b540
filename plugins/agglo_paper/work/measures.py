"""Measurements of agglomerate shapes and multigrid iterations on one mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from agglo_core.authoring import Diffusion, Hierarchy, OptionError, Solution, agglomerate, default, quality
from agglo_paper.work.grids import load, targets
from agglo_paper.work.strategies import Strategy

METRICS: Final = ("UF", "CR", "CRc")
SOLVER: Final = "polydg_mg_paper"
_PLAIN: Final = "polydg_cg"
_PROBLEM: Final = 8.0
"""Right-hand side of the printed counts; the text has 2π² sin πx sin πy."""


class Setting(NamedTuple):
    """Multigrid parameters: levels ℓ, smoothing steps m, polynomial degree p, and tolerance."""

    levels: int
    steps: int
    degree: int
    tolerance: float = 1e-6


SETTINGS: Final = (
    Setting(2, 3, 1),
    Setting(3, 3, 1),
    Setting(4, 3, 1),
    Setting(3, 1, 1, 1e-8),
    Setting(4, 1, 1, 1e-8),
    Setting(3, 5, 1),
    Setting(3, 3, 2),
    Setting(3, 3, 3),
)
FRESH: Final = (0, 1, 2, 3)
"""Settings counted on fresh meshes: ℓ = 2, 3, 4 with m = 3, and ℓ = 3 with m = 1."""


def measure(
    source: str, convention: str, strategy: Mapping[str, Any], numbering: int = 0, seed: int = 0
) -> dict[str, Any]:
    """Agglomerate a mesh, and measure the parts: count K, diameter over h*, UF, CR and CRc.

    UF is the uniformity factor, CR the circle ratio, and CRc the circle ratio about the centroid.
    """
    mesh = load(source, numbering)
    mesh_targets = targets(mesh, source, convention)
    labels = Strategy(**strategy).run(mesh, mesh_targets, seed).levels[0]
    values = quality(mesh, labels, METRICS)
    diameters = mesh.coarsen(labels).cell_diameters
    return {
        "K": len(diameters),
        "diameter": float(diameters.mean()) / mesh_targets.sizes[0],
        **{name: values[name].round(6).tolist() for name in METRICS},
    }


def _iterations(hierarchy: Hierarchy, setting: Setting) -> tuple[int, bool]:
    """Return the multigrid iteration count, and True if the paper's stopping test was met.

    The paper tests only the residual; the solver continues until the energy error is as small.
    """
    solver = default().build(
        "solver",
        SOLVER,
        levels=setting.levels,
        smoothing_steps=setting.steps,
        degree=setting.degree,
        tolerance=setting.tolerance,
    )
    solution = solver.solve(Diffusion(source=_PROBLEM), hierarchy)
    first = _first_met(solution, setting.tolerance)
    return (int(solution.iterations), False) if first is None else (first, True)


def _first_met(solution: Solution, tolerance: float) -> int | None:
    """Return the first iteration with a relative residual within the tolerance, or None if there is none."""
    met = solution.residuals <= tolerance * solution.residuals[0]
    return int(np.argmax(met)) if met.any() else None


def count(
    source: str, strategy: Mapping[str, Any], settings: Sequence[int], numbering: int = 0, seed: int = 0
) -> dict[str, Any]:
    """Count multigrid iterations for some of :data:`SETTINGS`, with None and a reason for invalid levels."""
    mesh = load(source, numbering)
    hierarchy = Strategy(**strategy).run(mesh, targets(mesh, source, "levels"), seed)
    outcomes: list[tuple[int, bool] | None] = []
    reasons = []
    for item in settings:
        try:
            outcomes.append(_iterations(hierarchy, SETTINGS[item]))
        except OptionError as error:  # for example a level that does not coarsen
            outcomes.append(None)
            reasons.append(str(error))
    return {
        "parts": hierarchy.parts,
        "iterations": [item and item[0] for item in outcomes],
        "converged": [bool(item and item[1]) for item in outcomes],
        "reasons": reasons,
    }


def plain(source: str, degree: int, tolerances: Sequence[float]) -> dict[str, Any]:
    """Count iterations of conjugate gradients without preconditioner to each tolerance, None if never met.

    ``smallest`` is the number of the iterate with the smallest residual, used if no tolerance is met.
    """
    mesh = load(source)
    hierarchy = agglomerate(mesh, bisector="inertial", n_parts=1)
    solver = default().build("solver", _PLAIN, degree=degree, tolerance=min(tolerances))
    solution = solver.solve(Diffusion(source=_PROBLEM), hierarchy)
    first = [_first_met(solution, tolerance) for tolerance in tolerances]
    return {"iterations": first, "smallest": int(solution.iterations)}


def fresh(source: str, strategy: Mapping[str, Any], solve: bool) -> dict[str, Any]:
    """Measure shapes and, optionally, iterations on one newly generated mesh, None without convergence."""
    shapes = measure(source, "run", strategy)
    values: dict[str, Any] = {name: float(np.mean(shapes[name])) for name in ("K", *METRICS)}
    if solve:
        counts = count(source, strategy, FRESH)
        both = zip(counts["iterations"], counts["converged"], strict=True)
        values["levels"] = [number if converged else None for number, converged in both]
    return values
