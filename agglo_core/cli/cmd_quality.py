"""``agglo quality``: shape metrics of the agglomerates in a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from agglo_core.cli.console import hush, number, print_json, print_table

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

__all__ = ["quality"]

_COLUMNS = ("level", "parts", "max_diameter", "UF", "CR", "CRc", "connected")


@click.command(short_help="Measure the agglomerates in a file.")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors (and JSON, if asked for).")
def quality(file: Path, as_json: bool, quiet: bool) -> None:
    """Print mean UF, CR and CRc of every level stored in FILE.

    Levels are those of a hierarchy (.npz) or the cell data level_0, level_1, …; a file without any has
    its cells measured as they are.
    """
    if quiet:
        hush()
    from agglo_core.io import read_hierarchy
    from agglo_core.measure.agglomerates import summary

    mesh, stored = read_hierarchy(file)
    names, hierarchy = _levels(mesh, stored)
    rows = [
        {"level": name, **{key: row[key] for key in _COLUMNS[1:]}}
        for name, row in zip(names, summary(mesh, hierarchy), strict=True)
    ]
    if as_json:
        print_json({"mesh": {"name": mesh.name, "cells": mesh.n_cells, "h0": mesh.h}, "levels": rows})
    elif not quiet:
        title = f"{mesh.name or file.name}: {mesh.n_cells:,} cells, h0 = {number(mesh.h)}"
        print_table(title, _COLUMNS, [[number(row[key]) for key in _COLUMNS] for row in rows])


def _levels(mesh: Mesh, stored: Hierarchy | None) -> tuple[list[str], Hierarchy]:
    """Names and labels of the stored levels; of the cells as they are if there are none."""
    if stored is not None:
        return [f"level_{place}" for place in range(len(stored.levels))], stored
    import numpy as np

    from agglo_core.hierarchy import Hierarchy

    return ["cells"], Hierarchy(mesh, mesh.graph, [np.arange(mesh.n_cells)], [{}], nested=True)
