"""Measuring partitions: values per agglomerate, and one line per level."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int
from agglo_core.crew import Member, attributed
from agglo_core.errors import MeshError, OptionError, PluginError
from agglo_core.mesh import Mesh
from agglo_core.plugins import describe
from agglo_core.protocols import QualityMetric

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.plugins import Registry

__all__ = ["quality", "summary"]

Metric = str | QualityMetric | tuple[str, Mapping[str, Any]]
"""A metric's name, a metric, or a name with its options."""


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
        For an option or a metric that does not exist, or misbehaves.

    Examples
    --------
    >>> from agglo_core import quality, samples
    >>> quality(samples.squares(4), [0] * 16)["CR"]
    array([0.70710678])
    """
    labels = mesh.check_labels(labels)
    return _measured(mesh, mesh.coarsen(labels), labels, _built(metrics, registry))


def summary(mesh: Mesh, hierarchy: Hierarchy, registry: Registry | None = None) -> list[dict[str, Any]]:
    """One plain dict per level, finest first.

    Keys: ``target``, ``parts``, ``max_diameter``, the means of ``UF``, ``CR``, ``CRc`` (the last two
    None in 3-D) and ``connected``, the share of parts that are connected.
    """
    ratios = ("UF", "CR", "CRc") if mesh.dim == 2 else ("UF",)
    metrics = _built((*ratios, "components"), registry)
    lines = []
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        coarse = mesh.coarsen(labels)
        values = _measured(mesh, coarse, labels, metrics)
        means = {name: float(values[name].mean()) if name in values else None for name in ("UF", "CR", "CRc")}
        lines.append(
            {
                "target": target,
                "parts": coarse.n_cells,
                "max_diameter": coarse.h,
                **means,
                "connected": float((values["components"] == 1).mean()),
            }
        )
    return lines


def _built(metrics: Iterable[Metric], registry: Registry | None) -> dict[str, Member]:
    """Metric objects, and how errors call them, by name."""
    if isinstance(metrics, str):
        raise OptionError(f"metrics must be a list or tuple of names, not the text {metrics!r}")
    built: dict[str, Member] = {}
    for metric in metrics:
        name, options = metric if isinstance(metric, tuple) else (metric, {})
        if isinstance(name, str):
            component = _registry(registry).build("metric", name, **options)
            title = describe(_registry(registry).record("metric", name))
        else:
            component, name = name, type(name).__name__
            title = f"metric {name!r}"
        if name in built:
            raise OptionError(f"metric {name!r} is given twice")
        if not callable(getattr(component, "measure", None)):
            raise OptionError(f"{component!r:.60} is no metric: it has no method measure(mesh, labels)")
        built[name] = Member(component, title)
    return built


def _registry(registry: Registry | None) -> Registry:
    from agglo_core.plugins import default

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
