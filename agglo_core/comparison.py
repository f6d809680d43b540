"""Runs side by side: what each made of a mesh, measured agglomerate by agglomerate, and how long it took."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.mesh import Mesh
from agglo_core.report import quality

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy

__all__ = ["Level", "Run", "measure_levels", "timed_run", "wanted"]

_WORDS = {
    "h_factor": "h ≤ {:g} h0",
    "h_star": "h ≤ {:.4g}",
    "cells_per_part": "{:g} cells each",
    "n_parts": "{} parts",
}


@dataclass(frozen=True, eq=False)
class Level:
    """One coarse level and what was measured on its k agglomerates.

    Attributes
    ----------
    target : mapping
        What was asked for, e.g. ``{"h_star": 0.3}``.
    labels : (n_cells,) int
    mesh : Mesh
        The coarse mesh.
    values : mapping of name to (k,) float
        ``cells``, ``diameter``, ``measure``, ``UF``, in 2-D ``CR`` and ``CRc``, ``components``.
    """

    target: Mapping[str, Any]
    labels: Int
    mesh: Mesh
    values: Mapping[str, Float]

    @cached_property
    def line(self) -> dict[str, Any]:
        """The level in one line: plain data.

        The keys of :func:`agglo_core.report.summary`, and ``diameter_ratio``: the mean diameter over
        h*. What does not exist (circle ratios of solids, h* of a count) is None.
        """
        means = {name: self._mean(name) for name in ("UF", "CR", "CRc")}
        h_star = self.target.get("h_star")
        return {
            "target": dict(self.target),
            "parts": self.mesh.n_cells,
            "max_diameter": float(self.values["diameter"].max()),
            **means,
            "connected": float((self.values["components"] == 1).mean()),
            "diameter_ratio": None if h_star is None else float(self.values["diameter"].mean() / h_star),
        }

    def _mean(self, name: str) -> float | None:
        return float(self.values[name].mean()) if name in self.values else None


@dataclass(frozen=True, eq=False)
class Run:
    """One way to agglomerate a mesh and what came of it.

    Attributes
    ----------
    name : str
        Bisector as the user wrote it, and the method where runs differ in it.
    hierarchy : Hierarchy or None
        None if the run failed.
    levels : sequence of Level
        Finest first.
    seconds : float
        Wall clock of the agglomeration alone.
    error : str
        Why the run failed, if it did.
    """

    name: str
    hierarchy: Hierarchy | None
    levels: Sequence[Level] = ()
    seconds: float = 0.0
    error: str = ""


def measure_levels(mesh: Mesh, hierarchy: Hierarchy) -> list[Level]:
    """Measure every level of a hierarchy of ``mesh``, finest first."""
    ratios = ("CR", "CRc") if mesh.dim == 2 else ()
    levels = []
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        coarse = mesh.coarsen(labels)
        shapes = quality(coarse, np.arange(coarse.n_cells), ("UF", *ratios))
        values = {
            "cells": np.bincount(labels).astype(float),
            "diameter": coarse.cell_diameters,
            "measure": coarse.cell_measures,
            **shapes,
            **quality(mesh, labels, ("components",)),
        }
        levels.append(Level(target, labels, coarse, values))
    return levels


def timed_run(mesh: Mesh, name: str, agglomerated: Callable[[], Hierarchy]) -> Run:
    """Agglomerate on the clock, then measure the levels.

    Parameters
    ----------
    mesh : Mesh
    name : str
    agglomerated : callable
        Agglomerates ``mesh``; what it raises passes through.
    """
    _ = mesh.graph  # shared by all runs: not on the first one's clock
    start = time.perf_counter()
    hierarchy = agglomerated()
    seconds = time.perf_counter() - start
    return Run(name, hierarchy, measure_levels(mesh, hierarchy), seconds)


def wanted(target: Mapping[str, Any]) -> str:
    """A target in the words it was asked in: ``h ≤ 4 h0``, ``16 parts``; – if unknown."""
    for name, form in _WORDS.items():
        if target.get(name) is not None:
            return form.format(target[name])
    return f"{target['parts']} parts" if "parts" in target else "–"
