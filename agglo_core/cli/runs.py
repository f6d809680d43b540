"""Agglomeration runs of the commands: execution, measurement, and result display."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

from agglo_core.agglomeration.keywords import RULES, SIZES, TARGETS
from agglo_core.cli.output.console import number
from agglo_core.cli.output.tables import print_lines, print_table
from agglo_core.cli.stopping import find_interrupt
from agglo_core.errors import AggloError, OptionError
from agglo_core.progress import Listener, labelled, phase, shown
from agglo_core.registry.containment import PLUGIN_FAILURES

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.measure.agglomerates import Level
    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh

Metrics = list[Any] | None

_RATIO = "mean diam/h*"
_CLOCK = "CPU s"
_SIZES = "cells each"


def show_progress(quiet: bool = False) -> AbstractContextManager[Listener | None]:
    """Return a context that shows a progress bar on a terminal, or nothing if ``quiet``."""
    return nullcontext() if quiet else shown(lines=False)


def execute(
    mesh: Mesh,
    name: str,
    given: Mapping[str, Any],
    metrics: Metrics = None,
    progress: Listener | None = None,
    save: Callable[[Hierarchy, Sequence[Level]], object] | None = None,
) -> RunResult:
    """Agglomerate a mesh with the arguments ``given``, measure the levels and save the hierarchy.

    The hierarchy is saved even if measuring fails (then without levels), but not after an interrupt.
    """
    from agglo_core.agglomeration.one_call import agglomerate
    from agglo_core.measure.comparison import timed_run

    listen = labelled(progress, name)
    with phase(listen, "loading"):
        warm_up(given)
    hierarchies: list[Hierarchy] = []

    def build_hierarchy() -> Hierarchy:
        hierarchies.append(agglomerate(mesh, **given, progress=listen))
        return hierarchies[0]

    try:
        result = timed_run(mesh, name, build_hierarchy, metrics, progress=listen)
    except PLUGIN_FAILURES as error:
        if save is not None and hierarchies and find_interrupt(error) is None:
            save(hierarchies[0], ())
        raise
    if save is not None:
        save(hierarchies[0], result.levels)
    return result


def attempt(
    mesh: Mesh,
    name: str,
    given: Mapping[str, Any],
    metrics: Metrics = None,
    progress: Listener | None = None,
) -> RunResult:
    """Execute one of several runs as :func:`execute`, with the error message as result if it fails."""
    from agglo_core.measure.comparison import RunResult

    try:
        return execute(mesh, name, given, metrics, progress)
    except AggloError as error:
        if find_interrupt(error) is not None:
            raise
        return RunResult(name, None, error=str(error))


def warm_up(given: Mapping[str, Any]) -> None:
    """Agglomerate a tiny mesh, to keep imports and compilation out of the first run's time."""
    from agglo_core import samples
    from agglo_core.agglomeration.one_call import agglomerate

    sizes = any(name in given for name in SIZES)
    options = {name: value for name, value in given.items() if name not in (*TARGETS, *RULES)}
    try:
        agglomerate(samples.squares(4), **options, **({"h_factor": 2.0} if sizes else {"n_parts": 4}))
    except AggloError as error:
        if find_interrupt(error) is not None:
            raise
        # otherwise the run itself reports the error


def refuse_all_failed(runs: Sequence[RunResult]) -> None:
    """Raise OptionError if all runs failed."""
    if all(run.hierarchy is None for run in runs):
        reasons = dict.fromkeys(f"{run.name}: {run.error}" for run in runs)
        raise OptionError("all runs failed: " + "; ".join(reasons))


def data(mesh: Mesh, source: str, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return mesh and run data in JSON types, as printed by ``--json``."""
    return {"mesh": {"name": mesh.name or source, "cells": mesh.n_cells, "h0": mesh.h}, "runs": runs}


def level_data(level: Level) -> dict[str, Any]:
    """Return level data, with its target as a number: maximum diameter or part count."""
    target = level.line["target"]
    return level.line | {"target": target.get("h_star", target.get("n_parts"))}


def run_data(run: RunResult, bisector: str, method: str) -> dict[str, Any]:
    """Return data for one of several compared runs, with bisector, method and error message."""
    return {
        "bisector": bisector,
        "method": method,
        "levels": [level_data(level) for level in run.levels],
        "seconds": run.seconds if run.hierarchy else None,
        "cpu_seconds": run.cpu_seconds if run.hierarchy else None,
        "statistics": run.hierarchy.statistics if run.hierarchy else {},
        "error": run.error or None,
    }


def refuse_metrics(mesh: Mesh, metrics: Metrics) -> None:
    """Raise MeshError if a metric does not exist in 3-D and the mesh is 3-D.

    Raises
    ------
    MeshError
        If a metric does not exist in 3-D.
    """
    if metrics is None or mesh.dim == 2:
        return
    from agglo_core import samples
    from agglo_core.measure.agglomerates import measure_levels

    measure_levels(solid := samples.boxes(1), single_level(solid), metrics=metrics)


def single_level(mesh: Mesh) -> Hierarchy:
    """Return a hierarchy whose only level consists of the cells themselves."""
    import numpy as np

    from agglo_core.hierarchy import Hierarchy

    return Hierarchy(mesh, mesh.graph, [np.arange(mesh.n_cells)], [{}], nested=True)


def show(title: str, runs: Sequence[RunResult], only_finest: bool = False) -> None:
    """Print a table with one line per level, and error messages for failed runs."""
    every = [level for run in runs for level in run.levels]
    sized = any(level.line["diameter_ratio"] is not None for level in every)
    columns = _columns(every[0], sized)
    heads = ["target", *columns.values(), _CLOCK]
    rows = []
    for run in runs:
        levels = run.levels[:1] if only_finest else run.levels
        for place, level in enumerate(levels):
            row = ["" if place else run.name, *_cells(level, columns)]
            rows.append([*row, "" if place else f"{run.cpu_seconds:.2f}"])
        if run.error:
            rows.append([run.name, *["–"] * len(heads)])
    spare = ["connected", _SIZES, _CLOCK, "isoperimetric", _RATIO]
    print_table(title, ["bisector", *heads], rows, spare=spare, fold={"bisector": 8})
    print_lines("\n".join(f"{run.name}: {run.error}" for run in runs if run.error))
    print_lines(
        "\n".join(f"{run.name}: {_describe_time_limits(run)}" for run in runs if _describe_time_limits(run))
    )


def _describe_time_limits(run: RunResult) -> str:
    """Return a remark on the number of searches stopped by their time limit, or an empty text if none."""
    count = run.hierarchy.statistics.get("time_limits", 0) if run.hierarchy else 0
    searches = "a search" if count == 1 else f"{count:,} searches"
    return (
        f"the time limit stopped {searches}; the results are the best parts found until then" if count else ""
    )


def _columns(level: Level, sized: bool) -> dict[str, str]:
    """Return the table columns as keys and headings, with diameter over target size if ``sized``."""
    ratio_column = {"diameter_ratio": _RATIO} if sized and "diameter_ratio" not in level.metrics else {}
    sizes = {_SIZES: _SIZES} if "min_cells" in level.line else {}
    alike = (*level.metrics, "connected", *level.objectives)
    return {"parts": "K"} | sizes | ratio_column | {name: name for name in alike}


def _cells(level: Level, columns: Iterable[str]) -> list[str]:
    from agglo_core.measure.comparison import wanted

    line = {**level.line, **level.objectives}
    line["connected"] = f"{number(100.0 * line['connected'])} %"
    line[_SIZES] = "–".join(number(line[name]) for name in ("min_cells", "max_cells") if name in line)
    return [
        wanted(level.target),
        *(format_ratio(line[key]) + describe_undefined(level, key) for key in columns),
    ]


def describe_undefined(level: Level, name: str) -> str:
    """Return a remark on the number of agglomerates for which a metric is undefined."""
    count = level.undefined.get(name, 0)
    return f" ({count} undefined)" if count else ""


def format_ratio(value: Any) -> str:
    """Format a ratio: three decimals, or four digits for large numbers."""
    if isinstance(value, float) and abs(value) < 1000.0:
        return f"{value:.3f}"
    return number(value)
