"""Trade-offs between agglomeration runs: roundness, evenness and run time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float
from agglo_core.errors import OptionError
from agglo_core.measure.agglomerates import Level
from agglo_core.measure.comparison import RunResult

_ROUND: Final = ("CR", "J")
"""Roundness metrics in order of preference. The first metric available in all runs is used, otherwise the
first selected metric."""
_DIGITS: Final = 9
"""Decimal digits in comparisons, so that rounding differences do not count."""
_LEAST_SECONDS: Final = 1e-4


@dataclass(frozen=True, eq=False)
class Axis:
    """Quantity for comparing runs: one number per run, and the better direction.

    Attributes
    ----------
    label : str
    values : (n,) float
    high : bool
        Whether higher is better.
    """

    label: str
    values: Float
    high: bool = True

    @property
    def scores(self) -> Float:
        """The values, with signs such that higher is better."""
        return self.values if self.high else frozen_float(-self.values)


@dataclass(frozen=True, eq=False)
class TradeOffs:
    """Roundness and evenness of the finest level, and run time, for each completed run.

    Attributes
    ----------
    names : sequence of str
    places : (n,) int
        Indices of the completed runs among all runs.
    parts : (n,) int
    roundness, evenness : Axis
    seconds : (n,) float
        CPU time, at least a tenth of a millisecond.
    missing : sequence of str
        Runs that are not included.
    """

    names: Sequence[str]
    places: Sequence[int]
    parts: Sequence[int]
    roundness: Axis
    evenness: Axis
    seconds: Float
    missing: Sequence[str] = ()

    @property
    def labels(self) -> list[str]:
        """Run names, with the part count if it differs between runs."""
        if len(set(self.parts)) < 2:
            return list(self.names)
        return [f"{name}, K = {parts}" for name, parts in zip(self.names, self.parts, strict=True)]

    @property
    def front(self) -> Int:
        """Indices of the runs on the Pareto front of roundness and evenness, the roundest first."""
        shapes = np.stack([self.evenness.scores, self.roundness.scores], axis=1)
        kept = np.flatnonzero(not_dominated(shapes))
        order: Int = kept[np.lexsort((-shapes[kept, 1], shapes[kept, 0]))]
        return order

    @property
    def best(self) -> Mask:
        """Mask of the runs on the Pareto front of roundness, evenness and time."""
        scores = [self.evenness.scores, self.roundness.scores, -self.seconds]
        return not_dominated(np.stack(scores, axis=1))


def not_dominated(scores: Float) -> Mask:
    """Return a mask ``(n,)`` of the rows of ``scores (n, k)`` that no other row dominates.

    A row dominates another if it is nowhere lower and somewhere higher.
    """
    found = np.round(scores, _DIGITS)
    other, own = found[:, None], found[None, :]
    worse = (other >= own).all(axis=2) & (other > own).any(axis=2)
    mask: Mask = ~np.any(worse, axis=0)
    return mask


def trade_offs(runs: Sequence[RunResult]) -> TradeOffs:
    """Compare runs on one mesh by roundness and evenness of their finest levels, and by run time.

    Roundness is the mean CR, or the mean J if CR is missing, or else the mean of the first selected metric,
    with the metric's preferred direction. Evenness is the mean diameter over h* if all runs have a size,
    else the coefficient of variation of part measures.

    Raises
    ------
    OptionError
        If no run completed, or no metric is available in all runs.
    """
    finest_levels = [(place, run.levels[0]) for place, run in enumerate(runs) if run.levels]
    if not finest_levels:
        raise OptionError("there are no trade-offs to compare: there is no run, or none completed")
    levels = [level for _, level in finest_levels]
    places = [place for place, _ in finest_levels]
    return TradeOffs(
        names=[runs[place].name for place in places],
        places=places,
        parts=[level.mesh.n_cells for level in levels],
        roundness=_roundness(levels),
        evenness=_evenness(levels),
        seconds=frozen_float([max(runs[place].cpu_seconds, _LEAST_SECONDS) for place in places]),
        missing=[run.name for run in runs if not run.levels],
    )


def _roundness(levels: Sequence[Level]) -> Axis:
    chosen = [*(name for name in _ROUND if name in levels[0].metrics), *levels[0].metrics]
    for name in chosen:
        means = [float(level.line[name]) for level in levels if level.line.get(name) is not None]
        if len(means) == len(levels):
            high = levels[0].better.get(name, "high") == "high"
            return Axis(f"mean {name}", frozen_float(means), high)
    raise OptionError(
        "there are no trade-offs to compare: no metric is available in all runs; choose one for all runs, "
        "such as J"
    )


def _evenness(levels: Sequence[Level]) -> Axis:
    if all(level.target.get("h_star") is not None for level in levels):
        ratios = [level.values["diameter"].mean() / level.target["h_star"] for level in levels]
        return Axis("mean diameter over h*", frozen_float(ratios))
    measures = [level.values["measure"] for level in levels]
    return Axis(
        "variation of the measures", frozen_float([each.std() / each.mean() for each in measures]), high=False
    )
