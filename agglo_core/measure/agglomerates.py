"""Measuring partitions: values per agglomerate, and one line per level."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.agglomeration.border import Member, attributed
from agglo_core.arrays import Float, Int
from agglo_core.errors import MeshError, OptionError, PluginError
from agglo_core.mesh import Mesh
from agglo_core.protocols import QualityMetric
from agglo_core.registry import describe

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.registry import Registry

__all__ = ["Level", "measure_levels", "quality", "summary"]

Metric = str | QualityMetric | tuple[str, Mapping[str, Any]]
"""A metric's name, a metric, or a name with its options."""


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

        Keys: ``target``, ``parts``, ``max_diameter``, the means of ``UF``, ``CR``, ``CRc``, the share
        of parts that are ``connected``, and ``diameter_ratio``, the mean diameter over h*. What does
        not exist (circle ratios of solids, h* of a count) is None.
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


def quality(
    mesh: Mesh,
    labels: ArrayLike,
    metrics: Iterable[Metric] = ("UF", "CR", "CRc"),
    registry: Registry | None = None,
) -> dict[str, Float]:
    """Quality of every agglomerate.

    Parameters
    ----------
    mesh : Mesh
    labels : (n_cells,) int
        Agglomerate of each cell, 0..k−1.
    metrics : iterable
        Names, ``(name, options)`` pairs or metric objects (keyed by class name).
    registry : Registry, optional
        Where names are looked up; the program's own by default.

    Returns
    -------
    dict of name to (k,) float

    Raises
    ------
    MeshError
        If the labels do not fit, or a metric exists only in 2-D.
    OptionError, PluginError
        For an argument of a wrong kind, an option or a metric that does not exist, or misbehaves.

    Examples
    --------
    >>> from agglo_core import quality, samples
    >>> quality(samples.squares(4), [0] * 16)["CR"]
    array([0.70710678])
    """
    if not isinstance(mesh, Mesh):
        raise OptionError(f"quality needs a Mesh and its labels, given {type(mesh).__name__}")
    labels = mesh.check_labels(labels)
    return _measured(mesh, mesh.coarsen(labels), labels, _built(metrics, registry))


def measure_levels(mesh: Mesh, hierarchy: Hierarchy, registry: Registry | None = None) -> list[Level]:
    """Measure every level of a hierarchy of ``mesh``, finest first."""
    ratios = ("CR", "CRc") if mesh.dim == 2 else ()
    metrics = _built(("UF", *ratios, "components"), registry)
    levels = []
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        coarse = mesh.coarsen(labels)
        values = {
            "cells": np.bincount(labels).astype(float),
            "diameter": coarse.cell_diameters,
            "measure": coarse.cell_measures,
            **_measured(mesh, coarse, labels, metrics),
        }
        levels.append(Level(target, labels, coarse, values))
    return levels


def summary(mesh: Mesh, hierarchy: Hierarchy, registry: Registry | None = None) -> list[dict[str, Any]]:
    """One plain dict per level, finest first: :attr:`Level.line`."""
    return [level.line for level in measure_levels(mesh, hierarchy, registry)]


def _built(metrics: Iterable[Metric], registry: Registry | None) -> dict[str, Member]:
    """Metric objects, and how errors call them, by name."""
    if isinstance(metrics, str):
        raise OptionError(f"metrics must be a list or tuple of names, not the text {metrics!r}")
    if not isinstance(metrics, Iterable):
        raise OptionError(f"metrics must be a list or tuple of names, not {metrics!r:.60}")
    built: dict[str, Member] = {}
    for metric in metrics:
        name, options = _named(metric) if isinstance(metric, tuple) else (metric, {})
        if isinstance(name, str):
            component = _registry(registry).build("metric", name, **options)
            title = describe(_registry(registry).record("metric", name))
        else:
            component, name = name, type(name).__name__
            title = f"metric {name!r}"
        if name in built:
            raise OptionError(f"metric {name!r} is given twice")
        if isinstance(component, type) or not callable(getattr(component, "measure", None)):
            raise OptionError(
                f"{component!r:.60} is no metric: expected an object with the method measure(mesh, labels)"
            )
        built[name] = Member(component, title)
    return built


def _named(metric: tuple[Any, ...]) -> tuple[str, Mapping[str, Any]]:
    if len(metric) == 2 and isinstance(metric[0], str) and isinstance(metric[1], Mapping):
        return metric[0], metric[1]
    raise OptionError(f"a metric is a name, (name, options) or an object, not {metric!r:.60}")


def _registry(registry: Registry | None) -> Registry:
    from agglo_core.registry import default

    return default() if registry is None else registry


def _measured(mesh: Mesh, coarse: Mesh, labels: Int, metrics: Mapping[str, Member]) -> dict[str, Float]:
    """Values by name; metrics of the shape alone share the coarse mesh and what it caches."""
    own = np.arange(coarse.n_cells)
    values = {}
    for name, metric in metrics.items():
        given = (coarse, own) if getattr(metric.tool, "shape_only", False) else (mesh, labels)
        with attributed(metric, spare=MeshError):  # a metric may refuse a mesh, such as one in 3-D
            result = np.asarray(metric.tool.measure(*given), dtype=float)
        if result.shape != (coarse.n_cells,):
            raise PluginError(
                f"{metric.title} returned shape {result.shape}; "
                f"expected ({coarse.n_cells},), one value per agglomerate"
            )
        values[name] = result
    return values
