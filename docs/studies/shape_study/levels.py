"""Measure levels of partitions of a 2-D mesh, by number of parts or by size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np

from agglo_core.authoring import OBJECTIVES, Int, Mesh
from shape_study.partitions import RECIPES
from shape_study.work import SOLVERS, iterations, loaded, metrics_of, plane_solver, problems

Kind = Literal["counts", "sizes"]
KINDS: Final[tuple[Kind, ...]] = ("counts", "sizes")


def target_of(mesh: Mesh, kind: Kind, per_part: Sequence[int]) -> dict[str, list[float]]:
    """Targets, finest first: numbers of parts, or the diagonal of a cube of ``per_part`` mean cells."""
    if kind == "counts":
        return {"n_parts": [max(2, mesh.n_cells // cells) for cells in per_part]}
    volumes = np.array(per_part) * float(mesh.cell_measures.mean())
    return {"h_star": (np.sqrt(mesh.dim) * volumes ** (1.0 / mesh.dim)).tolist()}


def metrics_of_levels(
    mesh: Mesh, levels: Sequence[Int], target: dict[str, list[float]]
) -> tuple[dict[str, float], dict[str, str]]:
    """Means of all metrics over the levels, geometric means of objectives, and which way each is better.

    By size also the number of ``parts`` of all levels together, of which fewer are better, and the mean
    ``diameter_ratio``.
    """
    found = [metrics_of(mesh, labels) for labels in levels]
    better = dict(found[0][1])
    values = {name: float(np.mean([each[name] for each, _ in found])) for name in better}
    for name in OBJECTIVES:
        values[name] = float(np.exp(np.mean([np.log(max(each[name], 1e-300)) for each, _ in found])))
    if "h_star" in target:
        widths = [mesh.coarsen(labels).cell_diameters.mean() for labels in levels]
        values["diameter_ratio"] = float(np.mean(np.array(widths) / target["h_star"]))
        values["parts"] = float(sum(labels.max() + 1 for labels in levels))
        better |= {"diameter_ratio": "high", "parts": "low"}
    return values, better


def measured_levels(
    source: str, kind: Kind, per_part: Sequence[int], recipe: str, seed: int, degrees: Sequence[int]
) -> dict[str, dict[str, Any]]:
    """Metrics and outcomes of levels by name, plain data as of :func:`shape_study.work.measured`.

    Outcomes are iterations with all levels, and by size the number of ``parts``.
    """
    mesh = loaded(source)
    target = target_of(mesh, kind, per_part)
    levels = RECIPES[recipe].levels(mesh, target, seed)
    metrics, better = metrics_of_levels(mesh, levels, target)
    outcomes = {"parts": metrics["parts"]} if kind == "sizes" else {}
    for degree in degrees:
        for what, problem in problems(mesh).items():
            for name in SOLVERS:
                tool = plane_solver(name, degree)
                outcomes[f"{name} {what} p{degree}"] = iterations(mesh, levels, tool, problem)
    return {"metrics": metrics, "better": better, "outcomes": outcomes}
