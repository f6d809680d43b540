"""Choose a refiner's objective: a built-in objective, or a metric with a method ``changes``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.errors import OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.protocols import IncrementalMetric
from agglo_core.registry import Registry, default, describe
from agglo_core.registry.attribution import attributed
from agglo_core.suggestions import did_you_mean

Changes = Callable[[Graph, Int, Int, Int], Float]


@dataclass(frozen=True)
class ChosenObjective:
    """Objective that a refiner minimises. Metrics with ``better = "high"`` get a negative sign.

    Attributes
    ----------
    name : str
    rated : callable
        Returns the change in the sum over the parts for each move, before multiplication by ``sign``.
    sign : float
        −1 for metrics to maximise.
    of_parts : callable, optional
        Value per part ``(k,)`` for a graph and labels. None for metrics, which need a mesh.
    metric : object, optional
    title : str
        Name in error messages.
    """

    name: str
    rated: Changes
    sign: float = 1.0
    of_parts: Callable[[Graph, Int], Float] | None = None
    metric: Any = None
    title: str = ""

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Return the objective change ``(q,)`` per move, or raise PluginError if it is not finite."""
        with attributed(self.title):
            values = np.asarray(self.rated(graph, labels, cells, parts), dtype=float)
        if values.shape != cells.shape or not np.isfinite(values).all():
            raise PluginError(
                f"{self.title}: changes returned shape {values.shape}"
                f"{'' if np.isfinite(values).all() else ' with values that are not finite'}; "
                f"expected {cells.shape}, one finite number per move"
            )
        return self.sign * values


def choose_objective(objective: str | IncrementalMetric, registry: Registry | None = None) -> ChosenObjective:
    """Return the objective given by the name of an objective or metric, or by a metric object.

    Raises
    ------
    OptionError
        If the name is unknown, or the objective cannot evaluate single moves.
    PluginError
        If the metric of that name cannot be used.
    """
    # 1. A metric object.
    if not isinstance(objective, str):
        return _of_metric(type(objective).__name__, objective, f"metric {type(objective).__name__}")
    # 2. A built-in objective.
    entry = OBJECTIVES.get(objective)
    if entry is not None and entry.changes is not None:
        return ChosenObjective(
            entry.name, entry.changes, of_parts=entry.of_parts, title=f"objective {objective!r}"
        )
    # 3. A registered metric.
    source = default() if registry is None else registry
    plain = objective.rpartition("/")[2]
    names = {record.name for record in source.list() if record.kind == "metric"}
    if plain in names:
        title = describe(source.record("metric", objective))
        return _of_metric(objective, source.build("metric", objective), title)
    # 4. Neither: explain, and suggest a similar name.
    able = [name for name, candidate in OBJECTIVES.items() if candidate.changes is not None]
    if entry is not None:
        raise OptionError(
            f"objective {objective!r} cannot evaluate single moves; use one of {', '.join(able)}"
        )
    hint = did_you_mean(objective, [*able, *names])
    raise OptionError(
        f"no objective is named {objective!r}{hint}; there are {', '.join(able)}, and metrics with a method "
        "changes(graph, labels, cells, parts)"
    )


def _of_metric(name: str, metric: Any, title: str) -> ChosenObjective:
    if isinstance(metric, type) or not callable(getattr(metric, "changes", None)):
        raise OptionError(
            f"{title} cannot be optimised: it has no method changes(graph, labels, cells, parts) to "
            "evaluate moves"
        )
    sign = -1.0 if getattr(metric, "better", "low") == "high" else 1.0
    return ChosenObjective(name, metric.changes, sign, metric=metric, title=title)
