"""Level goals (part sizes or counts), and the division of counts among components and sides."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Integral, Real
from typing import Any

import numpy as np

from agglo_core.agglomeration.keywords import COUNTS, Numbers
from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.mesh import compared_diameters
from agglo_core.protocols import Target


class TooFewPartsError(OptionError):
    """Error: fewer parts requested than the mesh has connected components."""

    def __init__(self, parts: int, components: int) -> None:
        self.parts, self.components = parts, components
        super().__init__(
            f"too few parts, {parts}: the mesh has {components} disconnected components, "
            "and each needs at least one part"
        )


def apportion(k: int, measures: Float, cells: Int, least: Int | int = 1) -> Int:
    """Divide k parts among pieces in proportion to their measures.

    Each piece gets at least ``least`` parts and at most as many parts as cells. The quotas add up to k.
    Pieces whose share lies beyond these limits get the limit, and the other pieces divide the rest in
    proportion to their measures. If no piece has a measure, k is divided by cell count.

    Raises
    ------
    OptionError
        If the pieces need more parts, or have fewer cells.
    """
    fewest = int(np.broadcast_to(least, cells.shape).sum())
    if k < fewest:
        raise TooFewPartsError(k, fewest)
    if k > cells.sum():
        raise OptionError(f"too many parts, {k}: there are {int(cells.sum())} cells")
    if len(measures) == 1:
        return frozen_int([k])
    # 1. Ideal quotas, real numbers within the limits.
    share = measures if measures.sum() > 0 else cells
    ideal = _scale_to_limits(frozen_float(k * share / share.sum()), k, least, cells)
    low, high = -float(k), float(k)
    for _ in range(80):  # 2. Bisection: the sum of the rounded quotas ideal + shift increases with the shift.
        shift = 0.5 * (low + high)
        fits = np.clip(np.floor(ideal + shift + 0.5), least, cells).sum() <= k
        low, high = (shift, high) if fits else (low, shift)
    quotas = np.clip(np.floor(ideal + low + 0.5), least, cells).astype(np.int64)
    # 3. Give the missing parts to the pieces with the largest remainders.
    want = np.where(quotas < cells, ideal - quotas, -np.inf)
    quotas[np.argsort(-want, kind="stable")[: k - int(quotas.sum())]] += 1
    return frozen_int(quotas)


def _scale_to_limits(ideal: Float, k: int, least: Int | int, cells: Int) -> Float:
    """Scale the shares ``ideal`` by a common factor, clipped to the limits, so that their sum is k."""
    if (np.clip(ideal, least, cells) == ideal).all():
        return ideal
    low, high = -64.0, 64.0  # bisection for the exponent of the factor: the sum increases with it
    for _ in range(80):
        middle = 0.5 * (low + high)
        fits = np.clip(np.exp2(middle) * ideal, least, cells).sum() <= k
        low, high = (middle, high) if fits else (low, middle)
    return frozen_float(np.clip(np.exp2(low) * ideal, least, cells))


def split_quotas(quotas: Float, measures: Float, cells: Int) -> Float:
    """Return each side's part count ``(2B,)``: ``clamp(round(k · measure share), 1, min(k − 1, cells))``.

    Parameters
    ----------
    quotas : (B,) float
        Part count per block. The quotas of the two sides add up to it.
    measures : (2B,) float
        Measure per side.
    cells : (2B,) int
        Cell count per side.
    """
    sizes, measure = cells.reshape(-1, 2), measures.reshape(-1, 2)
    measure = np.where(measure.sum(axis=1, keepdims=True) > 0, measure, sizes)
    share = measure[:, 0] / measure.sum(axis=1)
    low = np.maximum(1.0, quotas - sizes[:, 1])
    high = np.minimum(quotas - 1.0, sizes[:, 0])
    first = np.clip(np.round(quotas * share), low, high)
    return frozen_float(np.stack((first, quotas - first), axis=1).ravel())


_ROUNDING = 1e-9
"""Relative tolerance: a part meets a size h* if its diameter is at most h* (1 + _ROUNDING)."""


@dataclass(frozen=True)
class SizeGoal:
    """Goal of a level: no part has a diameter above ``h_star``, except single cells.

    The state is the piece's diameter. The diameter is exact near ``h_star`` and near the ``coarser`` sizes,
    which are also requested. Elsewhere the state is any number on the correct side of all sizes.

    Examples
    --------
    >>> from agglo_core.agglomeration.goals import SizeGoal
    >>> goal = SizeGoal(0.5)
    >>> goal.target, goal.estimate(agglo.samples.squares(8).graph)
    (Target(parts=None, h_star=0.5), 11)
    """

    h_star: float
    requested: Mapping[str, Any] = field(default_factory=dict)
    coarser: tuple[float, ...] = ()

    @property
    def limit(self) -> float:
        """Largest admissible diameter of a part, including a tolerance for rounding errors."""
        return self.h_star * (1 + _ROUNDING)

    @property
    def target(self) -> Target:
        """This goal as the target that components receive."""
        return Target(h_star=self.h_star)

    def record(self, parts: int) -> Mapping[str, Any]:
        """Return the requested target as keywords and values, for a level with ``parts`` parts."""
        return self.requested

    def estimate(self, graph: Graph) -> int:
        """Estimate the number of parts with diameter ``h_star`` for a direct k-way partition.

        Typical parts fill half a ball with diameter ``h_star``.
        """
        ball = np.pi / 4 if graph.dim == 2 else np.pi / 6
        side = float((graph.measures.sum() / (0.5 * ball)) ** (1.0 / graph.dim)) / self.h_star
        return graph.n if side > graph.n else max(1, int(np.ceil(side**graph.dim)))

    def assess(
        self, graph: Graph, order: Int, offsets: Int, above: Float | None = None
    ) -> tuple[Float, Mask]:
        """Return the piece diameters, and a mask of the pieces that meet the goal."""
        shape = graph.vertex_offsets, graph.vertices, graph.points
        diameter = compared_diameters(offsets, order, *shape, self._limits)
        return diameter, (diameter <= self.limit) | (np.diff(offsets) == 1)

    @cached_property
    def _limits(self) -> Float:
        return frozen_float(np.sort((self.h_star, *self.coarser)) * (1 + _ROUNDING))


@dataclass(frozen=True)
class CountGoal:
    """Goal of a level: a part count.

    The state is the piece's quota: the number of parts to split it into. A piece with quota 1 is finished.
    Splits distribute the quota by mass. The initial pieces also get quotas by mass, unless their ``quotas``
    are given. A count that is not ``exact`` stands for a mean size: pieces and constraints may change the
    count.
    """

    parts: int
    requested: Mapping[str, Any] = field(default_factory=dict)
    quotas: Int | None = None
    exact: bool = True

    @property
    def limit(self) -> float:
        """Largest admissible diameter of a part: infinity, because only the part count matters."""
        return np.inf

    @property
    def target(self) -> Target:
        """This goal as the target that components receive."""
        return Target(parts=self.parts)

    def record(self, parts: int) -> Mapping[str, Any]:
        """Return the requested target as keywords and values, for a level with ``parts`` parts."""
        return self.requested if self.exact else {**self.requested, "n_parts": parts}

    def shares(self, measures: Float, cells: Int) -> Int:
        """Divide the part count among the initial pieces by measure: see :func:`apportion`."""
        parts = self.parts if self.exact else int(np.clip(self.parts, len(cells), cells.sum()))
        return apportion(parts, measures, cells)

    def estimate(self, graph: Graph) -> int:
        """Return the part count to request from a direct k-way partition."""
        return self.parts

    def assess(
        self, graph: Graph, order: Int, offsets: Int, above: Float | None = None
    ) -> tuple[Float, Mask]:
        """Divide the quotas ``above`` of the parents among the pieces, and mark the pieces with quota 1."""
        if above is not None:
            quotas = split_quotas(above, _sums(graph.mass, order, offsets), np.diff(offsets))
        elif self.quotas is not None:
            quotas = frozen_float(self.quotas)
        else:
            cells = np.diff(offsets)
            piece = np.repeat(np.arange(len(cells)), cells)
            masses = frozen_float(np.bincount(piece, graph.mass[order]))  # summed in the order of `growth`
            quotas = frozen_float(self.shares(masses, frozen_int(cells)))
        return quotas, quotas == 1


Goal = SizeGoal | CountGoal


def check_targets(targets: Mapping[str, Any]) -> None:
    """Raise OptionError if targets of several kinds are given, or a value is invalid on every mesh."""
    values = {name: value for name, value in targets.items() if value is not None}
    if len(values) > 1:
        raise OptionError(f"give one kind of target, not {' and '.join(values)}")
    for name, value in values.items():
        for number in _positive(name, value):
            if name == "n_parts" and number != int(number):
                raise OptionError(f"n_parts must be a whole number, given {number!r}")
            if name == "cells_per_part" and number < 0.5:
                raise OptionError(f"cells_per_part must be at least 1, given {number!r}")


_RATIO = 8
"""Default target: cells per part on the finest level, and parts per part on each further level. A larger
value takes more multigrid iterations (benchmarks/solid_ratios.py)."""
_COARSEST = 12
"""Default target: number of parts on the coarsest level, up to a factor of √8. A convention: few enough to
look at, and for a direct solver."""


def default_sizes(n_cells: int) -> tuple[int, ...]:
    """Return the default ``cells_per_part``: 8, 64, 512, … down to about 12 parts.

    There are ``max(1, round(log8(n_cells / 12)))`` levels. The coarsest level of a connected mesh with at
    least 32 cells has 4 to 34 parts. A connected mesh with fewer than 12 cells becomes one part.

    Examples
    --------
    >>> from agglo_core.agglomeration.goals import default_sizes
    >>> default_sizes(5000), default_sizes(100_000), default_sizes(5)
    ((8, 64, 512), (8, 64, 512, 4096), (8,))
    """
    levels = max(1, round(math.log(n_cells / _COARSEST, _RATIO)))
    return tuple(_RATIO ** (level + 1) for level in range(levels))


def resolve_goals(
    n_cells: int,
    h0: Callable[[], float],
    *,
    components: Callable[[], Int] | None = None,
    **targets: Numbers | None,
) -> tuple[Goal, ...]:
    """Convert the targets of a run, all of one kind, to the goals of its levels, finest first.

    On a connected mesh ``cells_per_part=c`` means round(n / c) parts. In general each connected component of
    up to c cells is one part, and the larger components, with m cells in total, are divided into round(m / c)
    parts. ``components()`` returns the cell count per component. ``h_factor`` is in units of the mesh size
    ``h0()``. Without a target ``cells_per_part`` is :func:`default_sizes`.

    Raises
    ------
    OptionError
        If several kinds are given, or a value is not positive and finite, or a count exceeds the number of
        cells.
    """
    check_targets(targets)
    given = ((name, value) for name, value in targets.items() if value is not None)
    name, value = next(given, ("cells_per_part", default_sizes(n_cells)))
    values = _positive(name, value)
    if name in COUNTS:
        counts = _counts(values, n_cells) if name == "n_parts" else _means(values, n_cells, components)
        return tuple(sorted(counts, key=lambda goal: -goal.parts))
    sizes = _sizes(values) if name == "h_star" else _multiples(values, h0())
    return tuple(sorted(sizes, key=lambda goal: goal.h_star))


def _sums(measures: Float, order: Int, offsets: Int) -> Float:
    from agglo_core.compiled.sums import slice_sums

    sums: Float = slice_sums(measures, order, offsets)
    return sums


def _sizes(values: Sequence[float]) -> list[SizeGoal]:
    return [SizeGoal(value, {"h_star": value}) for value in values]


def _multiples(values: Sequence[float], size: float) -> list[SizeGoal]:
    if not size > 0:
        raise OptionError("the cells have zero diameter, so h_factor is undefined: give h_star or n_parts")
    return [SizeGoal(value * size, {"h_star": value * size, "h_factor": value}) for value in values]


def _counts(values: Sequence[float], n: int) -> list[CountGoal]:
    counts = [_whole(value, n) for value in values]
    return [CountGoal(parts, {"n_parts": parts}) for parts in counts]


def _means(values: Sequence[float], n: int, components: Callable[[], Int] | None) -> list[CountGoal]:
    sizes = frozen_int([n]) if components is None else components()
    goals = []
    for value in values:
        parts = _whole(float(np.floor(np.maximum(1.0, sizes / value).sum() + 0.5)), n)
        goals.append(CountGoal(parts, {"n_parts": parts, "cells_per_part": value}, exact=False))
    return goals


def _whole(value: float, n: int) -> int:
    if value > n:
        raise OptionError(f"too many parts, {value:.6g}: the mesh has {n} cells")
    return int(value)


def _positive(name: str, value: Any) -> list[float]:
    is_list = isinstance(value, Sequence) and not isinstance(value, str)
    is_list = is_list or (isinstance(value, np.ndarray) and value.ndim > 0)
    values = list(value) if is_list else [value[()] if isinstance(value, np.ndarray) else value]
    if not values:
        raise OptionError(f"{name} is empty: give at least one value")
    for number in values:
        if isinstance(number, bool | np.bool_) or not isinstance(number, Real) or not _is_positive(number):
            raise OptionError(f"{name} must be positive and finite, given {number!r:.60}")
    return [float(number) if not isinstance(number, Integral) else int(number) for number in values]


def _is_positive(number: Real) -> bool:
    try:
        return 0 < float(number) < np.inf
    except OverflowError:  # an integer with hundreds of digits
        return False
