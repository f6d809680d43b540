"""Measure the quality of partitions: values per agglomerate, and a summary per level."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, plain_array, trusted_copy
from agglo_core.errors import MeshError, OptionError, PluginError
from agglo_core.measure.quality_values import Quality
from agglo_core.measure.selection import RATIOS, Metric, build_metrics, select
from agglo_core.mesh import Mesh
from agglo_core.progress import Listener, Notify, followed, part, phase
from agglo_core.registry.attribution import Member, attributed
from agglo_core.suggestions import suggest_keywords
from agglo_core.threads import using_threads

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.registry import Registry


@dataclass(frozen=True, eq=False)
class Level:
    """One coarse level with the measured values on its k agglomerates.

    Attributes
    ----------
    target : mapping
        The requested target, e.g. ``{"h_star": 0.3}``.
    labels : (n_cells,) int
    mesh : Mesh
        The coarse mesh.
    values : mapping of name to (k,) float
        ``cells``, ``diameter``, ``measure``, the metric values, ``components``.
    metrics : sequence of str
        Selected metric names. If a metric does not exist on the mesh, ``values`` lacks its name.
    objectives : mapping of name to float
        Selected objective values.
    better : mapping of name to "high" or "low"
        Preferred direction per metric.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.measure import measure_levels
    >>> mesh = agglo.samples.squares(4)
    >>> level = measure_levels(mesh, agglo.agglomerate(mesh, n_parts=4), metrics=("CR",))[0]
    >>> level.line["parts"], level.values["CR"].round(3), level.mesh.n_cells
    (4, array([0.707, 0.707, 0.707, 0.707]), 4)
    """

    target: Mapping[str, Any]
    labels: Int
    mesh: Mesh
    values: Mapping[str, Float]
    metrics: Sequence[str] = RATIOS
    objectives: Mapping[str, float] = field(default_factory=dict)
    better: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def line(self) -> dict[str, Any]:
        """Summary of the level as a dict of plain values.

        Keys: ``target``, ``parts``, ``min_cells``, ``max_cells``, ``max_diameter``, the mean of each metric
        by name (by default ``UF``, ``CR``, ``CRc``, ``J``, ``isoperimetric``), the share of ``connected``
        parts, ``diameter_ratio``, the mean diameter over h*, ``objectives`` if any were selected, and
        :attr:`undefined` if any value is undefined. Missing values (h* for a count) are None. Means are over
        the agglomerates with a value.
        """
        h_star = self.target.get("h_star")
        diameters = self.values["diameter"]
        line = {
            "target": dict(self.target),
            "parts": self.mesh.n_cells,
            "min_cells": int(self.values["cells"].min()),
            "max_cells": int(self.values["cells"].max()),
            "max_diameter": float(diameters.max()),
            **{name: self._mean(name) for name in self.metrics},
            "connected": float((self.values["components"] == 1).mean()),
        }
        line.setdefault("diameter_ratio", None if h_star is None else float(diameters.mean() / h_star))
        more = {"objectives": dict(self.objectives), "undefined": dict(self.undefined)}
        return line | {name: found for name, found in more.items() if found}

    @cached_property
    def undefined(self) -> Mapping[str, int]:
        """Number of agglomerates with an undefined value (NaN), for each metric that has any."""
        counts = {name: int(np.isnan(values).sum()) for name, values in self.values.items()}
        return {name: count for name, count in counts.items() if count}

    def _mean(self, name: str) -> float | None:
        values = self.values.get(name, np.empty(0))
        defined = values[~np.isnan(values)]
        return float(defined.mean()) if len(defined) else None


@suggest_keywords()
def quality(
    mesh: Mesh,
    labels: ArrayLike,
    metrics: Iterable[Metric] = RATIOS,
    registry: Registry | None = None,
    progress: Listener | None = None,
    verbose: bool = False,
    threads: int | None = None,
) -> Quality:
    """Compute quality metrics of every agglomerate.

    Parameters
    ----------
    mesh : Mesh
    labels : (n_cells,) int
        Agglomerate per cell, 0..k−1.
    metrics : iterable
        Names, ``(name, options)`` pairs or metric objects (keyed by class name).
    registry : Registry, optional
        Registry for name look-up. Default: the installed plugins.
    progress, verbose, threads : optional
        As for :func:`agglo_core.agglomerate`.

    Returns
    -------
    Quality
        A dict from name to (k,) float, displayed as a table.

    Raises
    ------
    MeshError
        If the labels do not fit the mesh, or a metric exists only in 2-D.
    OptionError, PluginError
        For an argument of a wrong type, an unknown option or metric, or a metric that misbehaves.

    Examples
    --------
    >>> from agglo_core import quality, samples
    >>> quality(samples.squares(4), [0] * 16)["CR"]
    array([0.70710678])
    """
    if not isinstance(mesh, Mesh):
        raise OptionError(f"quality needs a Mesh and its labels, given {type(mesh).__name__}")
    labels, members = mesh.check_labels(labels), build_metrics(metrics, registry)
    with (
        using_threads(threads),
        followed(progress, verbose) as listen,
        phase(listen, "measuring") as notify,
    ):
        return Quality(_evaluate_metrics(mesh, mesh.coarsen(labels), labels, members, notify))


def measure_levels(
    mesh: Mesh,
    hierarchy: Hierarchy,
    registry: Registry | None = None,
    metrics: Iterable[Metric] | None = None,
    progress: Listener | None = None,
    verbose: bool = False,
) -> list[Level]:
    """Measure every level of a hierarchy of ``mesh``, finest first.

    Parameters
    ----------
    mesh : Mesh
    hierarchy : Hierarchy
    registry : Registry, optional
        Registry for name look-up. Default: the installed plugins.
    metrics : iterable, optional
        As for :func:`quality`, including objective names. Default: UF, CR, CRc, J and isoperimetric.
    progress, verbose : optional
        As for :func:`agglo_core.agglomerate`.

    Raises
    ------
    MeshError
        If a requested metric exists only in 2-D.
    OptionError, PluginError
        For an argument of a wrong type, an unknown option or name, or a metric that misbehaves.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.measure import measure_levels
    >>> mesh = agglo.samples.squares(8)
    >>> levels = measure_levels(mesh, agglo.agglomerate(mesh, n_parts=(16, 4)), metrics=("UF", "interface"))
    >>> [(level.line["parts"], level.line["UF"], level.objectives["interface"]) for level in levels]
    [(16, 1.0, 6.0), (4, 1.0, 2.0)]
    >>> int(levels[0].values["cells"].max())
    4
    """
    # 1. Metrics and objectives.
    selection = select(RATIOS if metrics is None else metrics, registry)
    names = tuple(selection.metrics)
    members = {**selection.metrics, **build_metrics(["components"], registry)}
    better = {name: getattr(metric.tool, "better", "high") for name, metric in selection.metrics.items()}
    levels: list[Level] = []
    coarse = mesh
    with followed(progress, verbose) as listen, phase(listen, "measuring") as notify:
        for place, (labels, target) in enumerate(zip(hierarchy.levels, hierarchy.targets, strict=True)):
            level_progress = part(notify, place, len(hierarchy.levels), f"level {place}")
            # 2. Coarsen the mesh, or the mesh of the level below if levels are nested.
            nested = place > 0 and hierarchy.nested
            coarse = coarse.coarsen(hierarchy.parents(place - 1)) if nested else mesh.coarsen(labels)
            # 3. Measure the level.
            values = {
                "cells": np.bincount(labels).astype(float),
                "diameter": coarse.cell_diameters,
                "measure": coarse.cell_measures,
                **_evaluate_metrics(mesh, coarse, labels, members, level_progress),
            }
            objectives = {
                objective.name: objective.value(hierarchy.graph, labels) for objective in selection.objectives
            }
            # 4. Keep the coarse mesh without its caches, which take several times its memory.
            bare = trusted_copy(coarse)
            levels.append(Level(target, labels, bare, values, names, objectives, better))
    return levels


def summary(
    mesh: Mesh,
    hierarchy: Hierarchy,
    registry: Registry | None = None,
    metrics: Iterable[Metric] | None = None,
) -> list[dict[str, Any]]:
    """Return a summary per level as a dict, finest first: :attr:`Level.line`.

    The arguments follow :func:`measure_levels`.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.measure import summary
    >>> mesh = agglo.samples.squares(8)
    >>> for line in summary(mesh, agglo.agglomerate(mesh, n_parts=(16, 4))):
    ...     print(line["parts"], round(line["CR"], 4), line["connected"])
    16 0.7071 1.0
    4 0.7071 1.0
    """
    return [level.line for level in measure_levels(mesh, hierarchy, registry, metrics)]


def _evaluate_metrics(
    mesh: Mesh, coarse: Mesh, labels: Int, metrics: Mapping[str, Member], notify: Notify
) -> dict[str, Float]:
    """Evaluate metrics, and return their values ``(k,)`` on the agglomerates by name.

    Metrics that depend only on the shape share the coarse mesh and its caches.
    """
    part_labels = np.arange(coarse.n_cells)
    values = {}
    for place, (name, metric) in enumerate(metrics.items()):
        part(notify, place, len(metrics), name)
        # 1. Measure on the coarse mesh where possible.
        arguments = (coarse, part_labels) if getattr(metric.tool, "shape_only", False) else (mesh, labels)
        with attributed(metric.title, spare=(MeshError,)):  # a metric may reject a mesh, for example in 3-D
            array = plain_array(metric.tool.measure(*arguments), "the result of measure", PluginError)
            result = np.asarray(array, dtype=float)
        # 2. Check the result.
        if result.shape != (coarse.n_cells,):
            raise PluginError(
                f"{metric.title} returned shape {result.shape}; "
                f"expected ({coarse.n_cells},), one value per agglomerate"
            )
        values[name] = result
    return values
