"""Select quality metrics and objectives: turn names and options into objects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from agglo_core.errors import OptionError, PluginError
from agglo_core.graph.objectives import OBJECTIVES, Objective
from agglo_core.protocols import QualityMetric
from agglo_core.registry import Registry, default, describe
from agglo_core.registry.attribution import Member
from agglo_core.registry.containment import shown
from agglo_core.registry.options import is_named, name_and_options
from agglo_core.suggestions import did_you_mean

Metric = str | QualityMetric | tuple[str, Mapping[str, Any]]
"""A metric's name, a metric, or a name with its options."""

RATIOS = ("UF", "CR", "CRc", "J", "isoperimetric")
"""Default metrics."""

_RESERVED = (
    *("connected", "diameter", "max_cells", "max_diameter", "measure", "min_cells", "objectives"),
    *("parts", "target"),
)


@dataclass(frozen=True)
class Selection:
    """Selected metrics by display name, and selected objectives."""

    metrics: Mapping[str, Member]
    objectives: tuple[Objective, ...] = ()


def select(chosen: Iterable[Metric], registry: Registry | None = None) -> Selection:
    """Build the metrics with the given names, and select objectives for names that are not metrics.

    Raises
    ------
    OptionError
        For an argument of a wrong type, or an unknown option.
    PluginError
        If a name is neither a metric nor an objective.
    """
    # 1. Separate objectives from metrics; a metric takes precedence.
    source = default() if registry is None else registry
    items = _check_list(chosen)
    metric_names = {record.name for record in source.list() if record.kind == "metric"}
    names = [
        item for item in items if isinstance(item, str) and item in OBJECTIVES and item not in metric_names
    ]
    metric_items = [item for item in items if item not in names]
    for item in metric_items:
        if isinstance(item, str) and "/" not in item and item not in metric_names:
            raise PluginError(_describe_unknown_name(item, sorted(metric_names)))
    # 2. Build the metrics, and check the names.
    metrics = build_metrics(metric_items, source)
    for name in metrics:
        if name in _RESERVED:
            raise OptionError(
                f"metric {name!r} cannot be selected: the name is reserved for a value of every level"
            )
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise OptionError(f"objective {twice[0]!r} is given twice")
    return Selection(metrics, tuple(OBJECTIVES[name] for name in names))


def build_metrics(chosen: Iterable[Metric], registry: Registry | None = None) -> dict[str, Member]:
    """Build metrics from names or objects, and return them by name, with titles for error messages."""
    source = default() if registry is None else registry
    built: dict[str, Member] = {}
    for metric in _check_list(chosen):
        # 1. Build the metric, or use the object.
        if is_named(metric):
            name, options = name_and_options("metric", metric)
            title = describe(source.record("metric", name))
            component = source.build("metric", name, **options)
        else:
            component, name = metric, type(metric).__name__
            title = f"metric {name!r}"
        # 2. Reject duplicates and objects that are not metrics.
        if name in built:
            raise OptionError(f"metric {name!r} is given twice")
        if isinstance(component, type) or not callable(getattr(component, "measure", None)):
            raise OptionError(
                f"{shown(component)} is not a metric: "
                "expected an object with the method measure(mesh, labels)"
            )
        built[name] = Member(component, title)
    return built


def _describe_unknown_name(name: str, metrics: Sequence[str]) -> str:
    hint = did_you_mean(name, [*metrics, *OBJECTIVES])
    return (
        f"no metric or objective is named {name!r}{hint}; metrics: {', '.join(metrics) or 'none'}; "
        f"objectives: {', '.join(OBJECTIVES)}"
    )


def _check_list(metrics: Iterable[Metric]) -> list[Metric]:
    if isinstance(metrics, str):
        raise OptionError(f"metrics must be a list or tuple of names, not the text {metrics!r}")
    if not isinstance(metrics, Iterable):
        raise OptionError(f"metrics must be a list or tuple of names, not {shown(metrics)}")
    return list(metrics)
