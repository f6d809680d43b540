"""From results to numbers of a page: rank correlations, and how much shapes cost."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from agglo_core.authoring import Float
from shape_study.partitions import RECIPES

_SAME: Final = 1e-6
"""Of the variance: where less is left once the ranks of a metric are taken out, it was that metric."""


@dataclass(frozen=True)
class Measured:
    """A partition and what was measured of it: see :func:`shape_study.work.measured`."""

    source: str
    recipe: str
    seed: int
    result: Mapping[str, Mapping[str, Any]]

    @property
    def usual(self) -> bool:
        """True if its recipe is a usual one."""
        return RECIPES[self.recipe].usual

    def outcome(self, name: str) -> float:
        """Iterations or error."""
        return float(self.result["outcomes"][name])

    def badness(self, metric: str) -> float:
        """Value of a metric, turned so that less is better."""
        sign = -1.0 if self.result["better"][metric] == "high" else 1.0
        return sign * float(self.result["metrics"][metric])


def correlations(
    rows: Sequence[Measured], metrics: Iterable[str], outcomes: Sequence[str], given: str = ""
) -> dict[str, list[float]]:
    """Spearman's rank correlation of each metric with each outcome, the mean over the meshes.

    1 where a worse value always goes with a worse outcome; NaN where either never changes. ``given`` names a
    metric whose part in both is taken out: a partial correlation.
    """
    meshes = _by_mesh(rows)
    found = {}
    for metric in metrics:
        badness = [np.array([row.badness(metric) for row in own]) for own in meshes]
        found[metric] = [
            _mean([_correlation(x, own, name, given) for x, own in zip(badness, meshes, strict=True)])
            for name in outcomes
        ]
    return found


def _correlation(x: Float, rows: Sequence[Measured], outcome: str, given: str) -> float:
    y = np.array([row.outcome(outcome) for row in rows])
    plain = _spearman(x, y)
    if not given:
        return plain
    z = np.array([row.badness(given) for row in rows])
    xz, yz = _spearman(x, z), _spearman(y, z)
    rest = (1.0 - xz**2) * (1.0 - yz**2)
    return (plain - xz * yz) / float(np.sqrt(rest)) if rest > _SAME else float("nan")


def relative(rows: Sequence[Measured], outcomes: Sequence[str]) -> dict[str, list[float]]:
    """Outcomes of each recipe over the best of each mesh: geometric means over meshes and seeds."""
    gathered: dict[str, list[Float]] = {}
    for own in _by_mesh(rows):
        values = np.array([[row.outcome(name) for name in outcomes] for row in own])
        for row, logs in zip(own, np.log(values / values.min(axis=0)), strict=True):
            gathered.setdefault(row.recipe, []).append(logs)
    return {recipe: np.exp(np.mean(logs, axis=0)).tolist() for recipe, logs in gathered.items()}


def costs(rows: Sequence[Measured], outcomes: Sequence[str]) -> dict[str, list[float]]:
    """By how much the worst partition of a mesh exceeds the best, geometric means over the meshes."""
    usual = [row for row in rows if row.usual]
    return {
        "worst of all over best": _ranges(rows, outcomes),
        "worst usual over best usual": _ranges(usual, outcomes),
    }


def _ranges(rows: Sequence[Measured], outcomes: Sequence[str]) -> list[float]:
    tables = [np.array([[row.outcome(name) for name in outcomes] for row in own]) for own in _by_mesh(rows)]
    logs = [np.log(table.max(axis=0) / table.min(axis=0)) for table in tables]
    return [float(each) for each in np.exp(np.mean(logs, axis=0))] if logs else [float("nan")] * len(outcomes)


def _by_mesh(rows: Iterable[Measured]) -> list[list[Measured]]:
    gathered: dict[str, list[Measured]] = {}
    for row in rows:
        gathered.setdefault(row.source, []).append(row)
    return list(gathered.values())


def _spearman(x: Float, y: Float) -> float:
    """NaN where one of them is the same everywhere, but for rounding."""
    from scipy.stats import spearmanr

    x, y = _rounded(x), _rounded(y)
    if len(x) < 3 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0 or not np.isfinite(x + y).all():
        return float("nan")
    return float(spearmanr(x, y).statistic)


def _rounded(values: Float) -> Float:
    """To nine digits of the largest: what differs by rounding has the same rank."""
    size = float(np.abs(values).max(initial=0.0))
    rounded: Float = np.round(values / size, 9) if size > 0.0 else values
    return rounded


def _mean(values: Sequence[float]) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of nothing but NaN
        return float(np.nanmean(values)) if len(values) else float("nan")
