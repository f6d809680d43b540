"""What the page shows, as JSON: arrays in base64, in the smallest type that holds them."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.draw.plot import PALETTE, colouring
from agglo_core.errors import MeshError, OptionError
from agglo_core.measure.comparison import Level, RunResult, wanted
from agglo_core.mesh import Mesh
from agglo_core.registry.discovery import version_of

__all__ = ["payload"]

_ROUNDING = 1e-6
_INTEGERS = (("Uint8", "<u1"), ("Uint16", "<u2"), ("Uint32", "<u4"))


def payload(mesh: Mesh, runs: Sequence[RunResult], note: str = "") -> dict[str, Any]:
    """Plain data of mesh and runs for the page; raises as :func:`write_page` does.

    Coordinates are relative to the origin of the mesh, as float32: a millionth of its size. The
    outside of the domain is cell ``n_cells``.
    """
    if mesh.dim != 2:
        raise MeshError(f"reports show only 2-D meshes; {mesh.name or 'this one'} is {mesh.dim}-D")
    if all(run.hierarchy is None for run in runs):
        raise OptionError("nothing to report: there is no run, or none came to an end")
    used, vertices = np.unique(mesh.face_vertices, return_inverse=True)
    return {
        "version": version_of("agglo"),
        "name": mesh.name or "mesh",
        "note": note,
        "cells": mesh.n_cells,
        "h0": mesh.h,
        "points": _reals(mesh.local_points[used]),
        "faces": _integers(vertices),
        "sides": _integers(np.where(mesh.face_cells < 0, mesh.n_cells, mesh.face_cells)),
        "palette": PALETTE,
        "metrics": _axes(runs),
        "objectives": list(dict.fromkeys(name for level in _levels(runs) for name in level.objectives)),
        "runs": [_run(run) for run in runs],
    }


def _levels(runs: Sequence[RunResult]) -> list[Level]:
    return [level for run in runs for level in run.levels]


def _axes(runs: Sequence[RunResult]) -> list[dict[str, Any]]:
    """Metrics and the ends of their axes: 0 and 1 for values in between, else the least and the largest."""
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


def _run(run: RunResult) -> dict[str, Any]:
    levels = [_level(level) for level in run.levels]
    return {"name": run.name, "seconds": run.seconds, "error": run.error, "levels": levels}


def _level(level: Level) -> dict[str, Any]:
    return {
        **{key: _finite(value) for key, value in level.line.items() if key != "target"},
        "target": wanted(level.target),
        "labels": _integers(level.labels),
        "colours": _integers(colouring(level.mesh, len(PALETTE))),
        "values": {name: _reals(values) for name, values in level.values.items()},
    }


def _finite(value: Any) -> Any:
    """``value`` as JSON knows it: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _integers(values: ArrayLike) -> dict[str, str]:
    array = np.asarray(values)
    largest = int(array.max(initial=0))
    name, kind = next(pair for pair in _INTEGERS if largest <= np.iinfo(pair[1]).max)
    return _packed(name, array.astype(kind))


def _reals(values: ArrayLike) -> dict[str, str]:
    return _packed("Float32", np.asarray(values).astype("<f4"))


def _packed(name: str, array: NDArray[Any]) -> dict[str, str]:
    return {"type": name, "data": base64.b64encode(array.tobytes()).decode("ascii")}
