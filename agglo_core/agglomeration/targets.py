"""What the levels of a hierarchy are asked to be: sizes or counts, resolved against the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np

from agglo_core.errors import OptionError
from agglo_core.graph import Graph

__all__ = ["Levels", "resolve_targets"]

Numbers = float | Sequence[float]


@dataclass(frozen=True)
class Levels:
    """Targets finest first: all sizes, or all counts; ``asked`` is what each level reports."""

    sizes: tuple[float, ...]
    counts: tuple[int, ...]
    asked: tuple[dict[str, Any], ...]

    def one_by_one(self) -> list[Levels]:
        """Each target on its own."""
        return [
            Levels(self.sizes[i : i + 1], self.counts[i : i + 1], self.asked[i : i + 1])
            for i in range(len(self.asked))
        ]


def resolve_targets(
    graph: Graph,
    h0: float | None,
    *,
    h_star: Numbers | None = None,
    h_factor: Numbers | None = None,
    n_parts: Numbers | None = None,
    cells_per_part: Numbers | None = None,
) -> Levels:
    """Levels from exactly one of the four kinds of target; ``h_factor=(2, 4, 8)`` if none is given.

    ``h_factor`` is in units of ``h0``, the mesh size. ``cells_per_part=c`` means round(n / c) parts.

    Raises
    ------
    OptionError
        If several kinds are given, or a value is not positive and finite, or a count exceeds the
        number of cells.
    """
    kinds = {
        "h_star": h_star,
        "h_factor": h_factor,
        "n_parts": n_parts,
        "cells_per_part": cells_per_part,
    }
    given = {name: value for name, value in kinds.items() if value is not None}
    if len(given) > 1:
        raise OptionError(f"give one kind of target, not {' and '.join(given)}")
    name, value = next(iter(given.items()), ("h_factor", (2.0, 4.0, 8.0)))
    values = _positive(name, value)
    pairs: list[tuple[float, dict[str, Any]]]
    if name == "h_star":
        pairs = [(v, {"h_star": v}) for v in values]
    elif name == "h_factor":
        size = _mesh_size(graph) if h0 is None else h0
        if not size > 0:
            raise OptionError("the cells have no extent, so h_factor means nothing: give h_star or n_parts")
        pairs = [(v * size, {"h_star": v * size, "h_factor": v}) for v in values]
    elif name == "n_parts":
        pairs = [(_count(v, graph.n), {"n_parts": int(v)}) for v in values]
    else:
        for v in values:
            if v < 0.5:
                raise OptionError(f"cells_per_part must be at least 1, given {v!r}")
        counts = [(max(1, int(np.floor(graph.n / v + 0.5))), v) for v in values]
        pairs = [(_count(k, graph.n), {"n_parts": k, "cells_per_part": v}) for k, v in counts]
    sizes = name in ("h_star", "h_factor")
    pairs.sort(key=lambda pair: pair[0] if sizes else -pair[0])
    chosen = tuple(first for first, _ in pairs)
    asked = tuple(second for _, second in pairs)
    if sizes:
        return Levels(chosen, (), asked)
    return Levels((), tuple(int(k) for k in chosen), asked)


def _mesh_size(graph: Graph) -> float:
    return float(graph.part_diameters(np.arange(graph.n)).max())


def _positive(name: str, value: Any) -> list[float]:
    many = isinstance(value, Sequence) and not isinstance(value, str)
    many = many or (isinstance(value, np.ndarray) and value.ndim > 0)
    values = list(value) if many else [value[()] if isinstance(value, np.ndarray) else value]
    if not values:
        raise OptionError(f"{name} is empty: give at least one value")
    for each in values:
        if (
            isinstance(each, bool | np.bool_)
            or not isinstance(each, Real)
            or not np.isfinite(float(each))
            or float(each) <= 0
        ):
            raise OptionError(f"{name} must be positive and finite, given {each!r}")
    return [float(each) if not isinstance(each, Integral) else int(each) for each in values]


def _count(value: float, n: int) -> int:
    if not isinstance(value, int) and value != np.floor(value):
        raise OptionError(f"n_parts must be a whole number, given {value!r}")
    if value > n:
        raise OptionError(f"too many parts, {value:.6g}: the mesh has {n} cells")
    return int(value)
