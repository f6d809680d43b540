"""Runs weighed against one another: how round their parts are, how even, and how long they took."""

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
"""Metrics of roundness, the first that is known of all runs is taken; else the first that was chosen."""
_DIGITS: Final = 9
"""To which values are compared: what differs by rounding is as good."""
_LEAST_SECONDS: Final = 1e-4


@dataclass(frozen=True, eq=False)
class Axis:
    """A number of each run.

    Attributes
    ----------
    label : str
    values : (n,) float
    high : bool
        Whether more is better.
    """

    label: str
    values: Float
    high: bool = True

    @property
    def scores(self) -> Float:
        """The values, turned so that more is better."""
        return self.values if self.high else frozen_float(-self.values)


@dataclass(frozen=True, eq=False)
class TradeOffs:
    """The finest level of each run that came to an end.

    Attributes
    ----------
    names : sequence of str
    places : (n,) int
        Of the runs among those given.
    parts : (n,) int
    roundness, evenness : Axis
    seconds : (n,) float
        Wall clock, a tenth of a millisecond at least.
    missing : sequence of str
        Runs that have no place here.
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
        """Names, with the number of parts where it is not the same for all."""
        if len(set(self.parts)) < 2:
            return list(self.names)
        return [f"{name}, K = {parts}" for name, parts in zip(self.names, self.parts, strict=True)]

    @property
    def front(self) -> Int:
        """Runs to which no other is both rounder and more even, from the roundest to the most even."""
        shapes = np.stack([self.evenness.scores, self.roundness.scores], axis=1)
        kept = np.flatnonzero(not_dominated(shapes))
        order: Int = kept[np.lexsort((-shapes[kept, 1], shapes[kept, 0]))]
        return order

    @property
    def best(self) -> Mask:
        """Runs to which no other is rounder, more even and faster at once."""
        scores = [self.evenness.scores, self.roundness.scores, -self.seconds]
        return not_dominated(np.stack(scores, axis=1))


def not_dominated(scores: Float) -> Mask:
    """Rows of ``scores (n, k)`` to which no other row is as good everywhere and better somewhere ``(n,)``."""
    found = np.round(scores, _DIGITS)
    other, own = found[:, None], found[None, :]
    worse = (other >= own).all(axis=2) & (other > own).any(axis=2)
    mask: Mask = ~np.any(worse, axis=0)
    return mask


def trade_offs(runs: Sequence[RunResult]) -> TradeOffs:
    """Weigh runs on one mesh by their finest levels.

    Roundness is the mean CR; where that is not known the mean J, or else of the metric that was chosen first,
    and whether more of it is better is what the metric says. Evenness is the mean diameter over h* where all
    have a size, else the coefficient of variation of the measures of the parts.

    Raises
    ------
    OptionError
        If no run came to an end, or there is no metric that all of them have.
    """
    done = [(place, run.levels[0]) for place, run in enumerate(runs) if run.levels]
    if not done:
        raise OptionError("nothing to weigh: there is no run, or none came to an end")
    levels = [level for _, level in done]
    places = [place for place, _ in done]
    return TradeOffs(
        names=[runs[place].name for place in places],
        places=places,
        parts=[level.mesh.n_cells for level in levels],
        roundness=_roundness(levels),
        evenness=_evenness(levels),
        seconds=frozen_float([max(runs[place].seconds, _LEAST_SECONDS) for place in places]),
        missing=[run.name for run in runs if not run.levels],
    )


def _roundness(levels: Sequence[Level]) -> Axis:
    chosen = [*(name for name in _ROUND if name in levels[0].metrics), *levels[0].metrics]
    for name in chosen:
        means = [float(level.line[name]) for level in levels if level.line.get(name) is not None]
        if len(means) == len(levels):
            high = levels[0].better.get(name, "high") == "high"
            return Axis(f"mean {name}", frozen_float(means), high)
    raise OptionError("nothing to weigh: there is no metric that all runs have; choose one, such as J")


def _evenness(levels: Sequence[Level]) -> Axis:
    if all(level.target.get("h_star") is not None for level in levels):
        ratios = [level.values["diameter"].mean() / level.target["h_star"] for level in levels]
        return Axis("mean diameter over h*", frozen_float(ratios))
    measures = [level.values["measure"] for level in levels]
    return Axis(
        "variation of the measures", frozen_float([each.std() / each.mean() for each in measures]), high=False
    )
