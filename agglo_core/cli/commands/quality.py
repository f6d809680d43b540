"""``agglo quality``: compute shape metrics of the agglomerates in a file."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.cli.options.agglomeration import FILE
from agglo_core.cli.options.shared import metrics_option, threads_option
from agglo_core.cli.output.console import number, print_json, quieten
from agglo_core.cli.output.files import Outputs, check_picture, draw_runs
from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.output.tables import print_table
from agglo_core.cli.runs import describe_undefined, level_data, show_progress, single_level
from agglo_core.progress import phase

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.measure import Level
    from agglo_core.mesh import Mesh
    from agglo_core.progress import Listener


_log = logging.getLogger("agglo")
_SPARE = ("connected", "max_diameter", "isoperimetric", "min_cells", "max_cells")
"""Columns that a narrow terminal leaves out, in this order."""


@click.command(cls=OwnCommand, short_help="Measure the agglomerates in a file.")
@click.argument("file", type=FILE)
@click.option(
    "--labels",
    "label_files",
    type=FILE,
    multiple=True,
    help="Text with one part number per line and cell, such as METIS's .part.K; repeatable, finest first.",
)
@metrics_option
@threads_option
@click.option("--plot", type=FILE, help="Picture of the mesh and its levels (.png, .pdf, .svg).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors (and JSON with --json).")
def quality(
    file: Path,
    label_files: Sequence[Path],
    metrics: list[Any] | None,
    plot: Path | None,
    as_json: bool,
    quiet: bool,
) -> int:
    """Print the means of UF, CR, CRc, J and isoperimetric, or of other metrics, for every level in FILE.

    Levels come from --labels, from a hierarchy (.npz) or from the cell data level_0, level_1, … In a file
    without levels, the cells themselves are measured.
    """
    if quiet:
        quieten()
    from agglo_core.io import read_hierarchy
    from agglo_core.measure.agglomerates import measure_levels

    if plot is not None:
        check_picture(plot)
    with show_progress(quiet) as progress:
        with phase(progress, "reading", file.name):
            mesh, stored = read_hierarchy(file)
            stored = _read_labels(mesh, label_files) if label_files else stored
        names, hierarchy = _levels(mesh, stored)
        names = [each.name for each in label_files] or names
        levels = measure_levels(mesh, hierarchy, metrics=metrics, progress=progress)
    rows = [{"level": name} | level_data(level) for name, level in zip(names, levels, strict=True)]
    for row in rows:
        del row["target"]
    if as_json:
        print_json({"mesh": {"name": mesh.name, "cells": mesh.n_cells, "h0": mesh.h}, "levels": rows})
    elif not quiet:
        title = f"{mesh.name or file.name}: {mesh.n_cells:,} cells, h0 = {number(mesh.h)}"
        columns = _columns(levels)
        flat = [row | row.get("objectives", {}) for row in rows]
        table_rows = [
            [number(row[key]) + describe_undefined(level, key) for key in columns]
            for level, row in zip(levels, flat, strict=True)
        ]
        print_table(title, columns, table_rows, spare=_SPARE)
    outputs = Outputs()
    if plot is not None:
        with show_progress(quiet) as progress:
            _draw(outputs, plot, mesh, stored, levels, progress)
    return outputs.finish(listed=not (as_json or quiet))


def _read_labels(mesh: Mesh, files: Sequence[Path]) -> Hierarchy | None:
    """Return the hierarchy of the labels in text files, without part numbers that no cell has.

    Raises
    ------
    FileError
        With the file, for other texts, negative numbers, or another number of labels than cells.
    """
    import numpy as np

    from agglo_core.arrays import frozen_int, trusted_copy
    from agglo_core.errors import FileError
    from agglo_core.interchange import parts_from_metis
    from agglo_core.io.levels import split_levels

    tags = {}
    for i, file in enumerate(files):
        labels = parts_from_metis(file)
        if len(labels) != mesh.n_cells:
            raise FileError(f"{file}: {len(labels)} labels, expected one for each of {mesh.n_cells} cells")
        parts, numbers = np.unique(labels, return_inverse=True)
        tags[f"level_{i}"] = frozen_int(numbers)
        if parts[-1] >= len(parts):
            _log.info("%s: %d of the parts 0 to %d have cells", file, len(parts), parts[-1])
    return split_levels(trusted_copy(mesh, cell_tags=tags))[1]


def _draw(
    outputs: Outputs,
    plot: Path,
    mesh: Mesh,
    stored: Hierarchy | None,
    levels: Sequence[Level],
    progress: Listener | None,
) -> None:
    """Draw the mesh and the levels of a file, or the mesh alone if the file has no levels."""
    from agglo_core.draw.plot import draw_mesh
    from agglo_core.measure.comparison import RunResult

    if stored is None:
        outputs.picture(plot, lambda: draw_mesh(mesh, plot))
    else:
        run = RunResult(stored.statistics.get("bisector", "levels"), stored, levels)
        draw_runs(outputs, mesh, [run], plot, None, None, progress)


def _columns(levels: Sequence[Level]) -> list[str]:
    """Return the table columns, with mean diameter over target size if a level has a target size."""
    sized = any(level.line["diameter_ratio"] is not None for level in levels)
    first = ["level", "parts", "min_cells", "max_cells"]
    first += [*(["diameter_ratio"] if sized else []), "max_diameter"]
    metrics = [name for name in levels[0].metrics if name not in first]
    return [*first, *metrics, "connected", *levels[0].objectives]


def _levels(mesh: Mesh, stored: Hierarchy | None) -> tuple[list[str], Hierarchy]:
    """Return names and hierarchy of the levels in a file, or of its cells if it has no levels."""
    if stored is not None:
        return [f"level_{place}" for place in range(len(stored.levels))], stored
    return ["cells"], single_level(mesh)
