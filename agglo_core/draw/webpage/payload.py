"""Data of the report as JSON: mesh and runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agglo_core.arrays import Int
from agglo_core.draw.colours import PALETTE, colouring
from agglo_core.draw.webpage.fine_cells import order_along_curve, plane_faces, tags
from agglo_core.draw.webpage.packing import differences, integers, reals
from agglo_core.draw.webpage.stills import exploded_still, stills
from agglo_core.errors import OptionError
from agglo_core.measure.agglomerates import Level
from agglo_core.measure.comparison import RunResult, wanted
from agglo_core.mesh import Mesh
from agglo_core.registry.discovery import version_of

_ROUNDING = 1e-6  # tolerance for metric values in [0, 1]


def payload(mesh: Mesh, runs: Sequence[RunResult], note: str = "") -> dict[str, Any]:
    """Return mesh and runs in JSON types for the report.

    Exceptions are those of :func:`write_page`.

    A 2-D mesh is stored as points and faces, a solid as stills from several sides. Cell data (labels,
    tags) are stored once, sorted by ``order``. Entry k of ``order`` is the cell number.
    """
    if all(run.hierarchy is None for run in runs):
        raise OptionError("nothing to report: there are no runs, or all failed")
    order = order_along_curve(mesh)
    return {
        "version": version_of("agglo"),
        "name": mesh.name or "mesh",
        "note": note,
        "cells": mesh.n_cells,
        "h0": mesh.h,
        "size": "area" if mesh.dim == 2 else "volume",
        "order": differences(order),
        **({"plane": plane_faces(mesh, order)} if mesh.dim == 2 else {"stills": stills(mesh, order)}),
        "tags": tags(mesh, order),
        "palette": PALETTE,
        "metrics": _axes(runs),
        "objectives": list(dict.fromkeys(name for level in _levels(runs) for name in level.objectives)),
        "runs": [_run(run, mesh, order) for run in runs],
    }


def _levels(runs: Sequence[RunResult]) -> list[Level]:
    return [level for run in runs for level in run.levels]


def _axes(runs: Sequence[RunResult]) -> list[dict[str, Any]]:
    """Return the metrics with their axis limits: 0 and 1 if all values are between, else the extrema."""
    names = dict.fromkeys(name for level in _levels(runs) for name in level.metrics if name in level.values)
    axes = []
    for name in names:
        values = np.concatenate([level.values[name] for level in _levels(runs) if name in level.values])
        values = values[np.isfinite(values)]
        low, high = float(values.min(initial=np.inf)), float(values.max(initial=-np.inf))
        if not len(values) or (low >= -_ROUNDING and high <= 1.0 + _ROUNDING):
            low, high = 0.0, 1.0
        elif low == high:
            low, high = low - 0.5, high + 0.5
        axes.append({"name": name, "low": low, "high": high})
    return axes


def _run(run: RunResult, mesh: Mesh, order: Int) -> dict[str, Any]:
    levels = [_level(level, order) for level in run.levels]
    if mesh.dim == 3:
        for made, level in zip(levels, run.levels, strict=True):
            made["apart"] = exploded_still(mesh, level.labels, order)
    return {"name": run.name, "cpu_seconds": run.cpu_seconds, "error": run.error, "levels": levels}


def _level(level: Level, order: Int) -> dict[str, Any]:
    return {
        **{key: _finite(value) for key, value in level.line.items() if key != "target"},
        "target": wanted(level.target),
        "labels": integers(level.labels[order]),
        "colours": integers(colouring(level.mesh, len(PALETTE))),
        "values": {name: reals(values) for name, values in level.values.items()},
    }


def _finite(value: Any) -> Any:
    """Convert a value to JSON types, with null for NaN and infinities."""
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value
