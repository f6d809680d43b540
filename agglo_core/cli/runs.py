"""Runs as the commands carry them out and show them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.cli.console import number, print_table, progress
from agglo_core.cli.stopping import stopped_by
from agglo_core.errors import AggloError, OptionError

if TYPE_CHECKING:
    from agglo_core.measure.comparison import Run
    from agglo_core.mesh import Mesh

__all__ = ["LEVEL_KEYS", "attempt", "data", "execute", "level_data", "refuse_all_failed", "run_data", "show"]

LEVEL_KEYS = ("target", "parts", "max_diameter", "UF", "CR", "CRc", "connected")
_COLUMNS = ("parts", "UF", "CR", "CRc", "connected", "diameter_ratio")
_HEADS = ("target", "K", "UF", "CR", "CRc", "connected", "mean diam/h*", "seconds")


def execute(mesh: Mesh, name: str, given: Mapping[str, Any], quiet: bool) -> Run:
    """Warm up, agglomerate with the arguments ``given``, and measure; errors pass through."""
    from agglo_core.agglomeration.pipeline import agglomerate
    from agglo_core.measure.comparison import timed_run

    with progress(f"{name}: loading", quiet):
        _warm_up(given)
    with progress(name, quiet):
        return timed_run(mesh, name, lambda: agglomerate(mesh, **given))


def attempt(mesh: Mesh, name: str, given: Mapping[str, Any], quiet: bool) -> Run:
    """The same for one run among others: its failure is a result."""
    from agglo_core.measure.comparison import Run

    try:
        return execute(mesh, name, given, quiet)
    except AggloError as error:
        if stopped_by(error) is not None:
            raise
        return Run(name, None, error=str(error))


def _warm_up(given: Mapping[str, Any]) -> None:
    """Import packages and compile kernels on a tiny mesh: they must not be on the first run's clock."""
    from agglo_core import samples
    from agglo_core.agglomeration.pipeline import agglomerate

    targets = ("h_star", "h_factor", "n_parts", "cells_per_part")
    counts = "n_parts" in given or "cells_per_part" in given
    rest = {name: value for name, value in given.items() if name not in targets}
    try:
        agglomerate(samples.squares(4), **rest, **({"n_parts": 4} if counts else {"h_factor": 2.0}))
    except AggloError as error:
        if stopped_by(error) is not None:
            raise
        # else the run itself will tell


def refuse_all_failed(runs: Sequence[Run]) -> None:
    """Raise OptionError if no run came to an end."""
    if all(run.hierarchy is None for run in runs):
        reasons = dict.fromkeys(f"{run.name}: {run.error}" for run in runs)
        raise OptionError("no run came to an end: " + "; ".join(reasons))


def data(mesh: Mesh, source: str, runs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Plain data of a mesh and its runs, the form of ``--json``."""
    return {"mesh": {"name": mesh.name or source, "cells": mesh.n_cells, "h0": mesh.h}, "runs": runs}


def level_data(line: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """A level with its target as one number: the largest diameter, or how many parts."""
    asked = line["target"]
    return {key: line[key] for key in keys} | {"target": asked.get("h_star", asked.get("n_parts"))}


def run_data(run: Run, bisector: str, method: str) -> dict[str, Any]:
    """A run of a comparison: that of ``agglo run``, with method, diam/h*, and the error if it failed."""
    return {
        "bisector": bisector,
        "method": method,
        "levels": [level_data(level.line, (*LEVEL_KEYS, "diameter_ratio")) for level in run.levels],
        "seconds": run.seconds if run.hierarchy else None,
        "statistics": run.hierarchy.statistics if run.hierarchy else {},
        "error": run.error or None,
    }


def show(title: str, runs: Sequence[Run], written: Sequence[Path] = (), only_finest: bool = False) -> None:
    """Print one line a level, and the files written; why a run failed stands in a column of its own."""
    failed = any(run.error for run in runs)
    rows = []
    for run in runs:
        levels = run.levels[:1] if only_finest else run.levels
        for place, level in enumerate(levels):
            row = ["" if place else run.name, *_cells(level.target, level.line)]
            rows.append([*row, "" if place else f"{run.seconds:.2f}", *([""] if failed else [])])
        if run.error:
            rows.append([run.name, *["–"] * len(_HEADS), run.error])
    columns = ["bisector", *_HEADS, *(["note"] if failed else [])]
    print_table(title, columns, rows, fold="note")
    for path in written:
        click.echo(f"wrote {path}")


def _cells(target: Mapping[str, Any], line: Mapping[str, Any]) -> list[str]:
    from agglo_core.measure.comparison import wanted

    shown = dict(line) | {"connected": f"{number(100.0 * line['connected'])} %"}
    return [wanted(target), *(_short(shown[key]) for key in _COLUMNS)]


def _short(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else number(value)
