"""What the page shows, as JSON: arrays in base64, in the smallest type that holds them."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import agglo_core
from agglo_core.draw.plot import PALETTE, colouring
from agglo_core.errors import MeshError, OptionError
from agglo_core.measure.comparison import Level, Run, wanted
from agglo_core.mesh import Mesh

__all__ = ["payload"]

_INTEGERS = (("Uint8", "<u1"), ("Uint16", "<u2"), ("Uint32", "<u4"))


def payload(mesh: Mesh, runs: Sequence[Run], note: str = "") -> dict[str, Any]:
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
        "version": agglo_core.__version__,
        "name": mesh.name or "mesh",
        "note": note,
        "cells": mesh.n_cells,
        "h0": mesh.h,
        "points": _reals(mesh.local_points[used]),
        "faces": _integers(vertices),
        "sides": _integers(np.where(mesh.face_cells < 0, mesh.n_cells, mesh.face_cells)),
        "palette": PALETTE,
        "runs": [_run(run) for run in runs],
    }


def _run(run: Run) -> dict[str, Any]:
    levels = [_level(level) for level in run.levels]
    return {"name": run.name, "seconds": run.seconds, "error": run.error, "levels": levels}


def _level(level: Level) -> dict[str, Any]:
    return {
        **{key: value for key, value in level.line.items() if key != "target"},
        "target": wanted(level.target),
        "labels": _integers(level.labels),
        "colours": _integers(colouring(level.mesh, len(PALETTE))),
        "values": {name: _reals(values) for name, values in level.values.items()},
    }


def _integers(values: ArrayLike) -> dict[str, str]:
    array = np.asarray(values)
    largest = int(array.max(initial=0))
    name, kind = next(pair for pair in _INTEGERS if largest <= np.iinfo(pair[1]).max)
    return _packed(name, array.astype(kind))


def _reals(values: ArrayLike) -> dict[str, str]:
    return _packed("Float32", np.asarray(values).astype("<f4"))


def _packed(name: str, array: NDArray[Any]) -> dict[str, str]:
    return {"type": name, "data": base64.b64encode(array.tobytes()).decode("ascii")}
