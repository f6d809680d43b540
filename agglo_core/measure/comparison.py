"""Compare agglomeration runs on a mesh: values per agglomerate, and run times."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from agglo_core.compiled.first_run import compilation_time
from agglo_core.measure.agglomerates import Level, measure_levels
from agglo_core.measure.selection import Metric
from agglo_core.mesh import Mesh
from agglo_core.progress import Listener, phase

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.registry import Registry

_WORDS = {
    "h_factor": "h ≤ {:g} h0",
    "h_star": "h ≤ {:.4g}",
    "cells_per_part": "{:g} cells each",
    "n_parts": "{} parts",
}


@dataclass(frozen=True, eq=False)
class RunResult:
    """Result of one agglomeration run on a mesh.

    Attributes
    ----------
    name : str
        Bisector as the user wrote it, plus the method if it differs between runs.
    hierarchy : Hierarchy or None
        None for a failed run.
    levels : sequence of Level
        Finest first.
    seconds : float
        Wall-clock time of the agglomeration only.
    error : str
        Reason for a failure.
    cpu_seconds : float
        CPU time of the agglomeration only.

    Examples
    --------
    >>> from agglo_core.measure import RunResult
    >>> RunResult("mine", None, error="not today").error
    'not today'
    """

    name: str
    hierarchy: Hierarchy | None
    levels: Sequence[Level] = ()
    seconds: float = 0.0
    error: str = ""
    cpu_seconds: float = 0.0


Run = RunResult
"""Name of :class:`RunResult` in version 0.1."""


def timed_run(
    mesh: Mesh,
    name: str,
    agglomerated: Callable[[], Hierarchy],
    metrics: Iterable[Metric] | None = None,
    registry: Registry | None = None,
    progress: Listener | None = None,
) -> RunResult:
    """Run and time an agglomeration, then measure the quality of its levels.

    The time excludes the compilation of kernels, which happens once per computer.

    Parameters
    ----------
    mesh : Mesh
    name : str
    agglomerated : callable
        Agglomerates ``mesh``. Its exceptions pass through.
    metrics, registry, progress : optional
        As for :func:`measure_levels`. ``agglomerated`` reports its own progress.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.measure import timed_run
    >>> mesh = agglo.samples.squares(8)
    >>> run = timed_run(mesh, "mine", lambda: agglo.agglomerate(mesh, n_parts=16), metrics=("UF",))
    >>> run.levels[0].line["UF"], run.seconds > 0
    (1.0, True)
    """
    with phase(progress, "building the graph"):
        _ = mesh.graph  # shared by all runs, so not part of the first run's time
    with compilation_time() as compiling:
        start, cpu_start = time.perf_counter(), time.process_time()
        hierarchy = agglomerated()
        seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    seconds, cpu_seconds = seconds - compiling.seconds, cpu_seconds - compiling.cpu_seconds
    levels = measure_levels(mesh, hierarchy, registry, metrics, progress)
    return RunResult(name, hierarchy, levels, seconds, cpu_seconds=cpu_seconds)


def wanted(target: Mapping[str, Any]) -> str:
    """Format a target as the user requested it: ``h ≤ 4 h0``, ``16 parts``, or – if unknown.

    Examples
    --------
    >>> from agglo_core.measure import wanted
    >>> wanted({"h_factor": 4.0, "h_star": 0.1}), wanted({"n_parts": 16})
    ('h ≤ 4 h0', '16 parts')
    """
    for name, form in _WORDS.items():
        if target.get(name) is not None:
            return form.format(target[name])
    return f"{target['parts']} parts" if "parts" in target else "–"
