"""``agglo run``: agglomerate a mesh with one bisector or several, measure, draw, write."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.cli.console import explain_compilation, hush, number, print_json, print_table, progress
from agglo_core.cli.outputs import check_outputs, write_outputs
from agglo_core.cli.sources import load_mesh
from agglo_core.cli.specs import Value, numbers, parse_spec
from agglo_core.errors import OptionError
from agglo_core.plugins import default
from agglo_core.plugins.construct import resolve

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

__all__ = ["run"]

_TARGETS = {
    "h_star": "--h-star",
    "h_factor": "--h-factor",
    "n_parts": "--parts",
    "cells_per_part": "--cells-per-part",
}
_COLUMNS = ("target", "parts", "max_diameter", "UF", "CR", "CRc", "connected")
_WORDS = {
    "h_factor": "h ≤ {:g} h0",
    "h_star": "h ≤ {:.4g}",
    "cells_per_part": "{:g} cells each",
    "n_parts": "{} parts",
}
_COMPONENT = "NAME[:opt=val,…]"
_FILE = click.Path(path_type=Path)


@dataclass(frozen=True)
class _Run:
    label: str
    hierarchy: Hierarchy
    levels: list[dict[str, Any]]
    seconds: float


@click.command(short_help="Agglomerate a mesh: measure, draw, write.")
@click.argument("source", metavar="MESH|SAMPLE")
@click.option(
    "--bisector",
    "bisectors",
    multiple=True,
    metavar=_COMPONENT,
    help="How a piece is split (default kmeans); several are compared.",
)
@click.option("--method", type=click.Choice(["recursive", "kway"]), help="Default recursive.")
@click.option("--refiner", "refiners", multiple=True, metavar=_COMPONENT, help="Repeatable; 'none' for none.")
@click.option("--fixer", metavar=_COMPONENT, help="Default connectivity.")
@click.option("--h-star", callback=numbers(float), metavar="LIST", help="Largest diameters, a level each.")
@click.option("--h-factor", callback=numbers(float), metavar="LIST", help="The same over h0 (default 2,4,8).")
@click.option("--parts", "n_parts", callback=numbers(int), metavar="LIST", help="Numbers of agglomerates.")
@click.option("--cells-per-part", callback=numbers(float), metavar="LIST", help="Mean sizes of agglomerates.")
@click.option("--seed", type=click.IntRange(min=0), help="Default 0.")
@click.option("--config", type=_FILE, help="TOML file; options given here win.")
@click.option("-o", "--output", type=_FILE, help="Mesh and levels (.vtu, .npz, …); one file per bisector.")
@click.option("--plot", type=_FILE, help="Picture of mesh and levels (.png, .pdf, .svg).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors (and JSON, if asked for).")
def run(
    source: str,
    bisectors: tuple[str, ...],
    method: str | None,
    refiners: tuple[str, ...],
    fixer: str | None,
    h_star: tuple[float, ...] | None,
    h_factor: tuple[float, ...] | None,
    n_parts: tuple[int, ...] | None,
    cells_per_part: tuple[float, ...] | None,
    seed: int | None,
    config: Path | None,
    output: Path | None,
    plot: Path | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Agglomerate a mesh file, or a sample: squares:n=64, voronoi:n=5000,seed=3, paper:triangles, …

    Targets are one of --h-star, --h-factor, --parts, --cells-per-part: a comma list, a level for each.
    """
    if quiet:
        hush()
    choices: dict[str, Any] = {"method": method, "seed": seed, "config": config}
    choices |= {"h_star": h_star, "h_factor": h_factor, "n_parts": n_parts, "cells_per_part": cells_per_part}
    given = {name: value for name, value in choices.items() if value is not None} | _helpers(refiners, fixer)
    _check_choices(given, bisectors)
    files = check_outputs(output, plot, bisectors)
    chosen = {spec: _choice("bisector", spec) for spec in bisectors}
    mesh = load_mesh(source)
    if plot is not None and mesh.dim != 2:
        raise OptionError(f"--plot draws plane meshes; {mesh.name or source} is {mesh.dim}-dimensional")
    if not quiet:
        explain_compilation()
    runs = [_agglomerate(mesh, given | {"bisector": chosen[spec]}, spec, quiet) for spec in bisectors]
    runs = runs or [_agglomerate(mesh, given, None, quiet)]
    written = write_outputs(mesh, {each.label: each.hierarchy for each in runs}, files, plot)
    if as_json:
        print_json(_data(mesh, mesh.name or source, runs))
    elif not quiet:
        _show(mesh, mesh.name or source, runs, written)


def _choice(kind: str, spec: str) -> tuple[str, dict[str, Value]]:
    """Name and options of a component, one that can be used: found out before a mesh is read."""
    name, options = parse_spec(spec)
    resolve(default().record(kind, name))
    return name, options


def _helpers(refiners: tuple[str, ...], fixer: str | None) -> dict[str, Any]:
    """Refiners and fixer as arguments of ``agglomerate``; absent ones keep its defaults."""
    chosen: dict[str, Any] = {}
    if refiners:
        chosen["refiners"] = tuple(_choice("refiner", spec) for spec in refiners if spec != "none")
    if fixer is not None:
        chosen["fixer"] = _choice("fixer", fixer)
    return chosen


def _check_choices(given: Mapping[str, Any], bisectors: tuple[str, ...]) -> None:
    targets = [flag for name, flag in _TARGETS.items() if name in given]
    if len(targets) > 1:
        raise click.UsageError(f"{' and '.join(targets)} cannot be given together: choose one")
    twice = sorted({spec for spec in bisectors if bisectors.count(spec) > 1})
    if twice:
        raise click.UsageError(f"--bisector {', '.join(twice)} is given twice")


def _agglomerate(mesh: Mesh, given: Mapping[str, Any], spec: str | None, quiet: bool) -> _Run:
    from agglo_core.pipeline import agglomerate
    from agglo_core.report import summary

    _ = mesh.graph  # built once, and not on the first bisector's clock
    with progress(spec or "agglomerating", quiet):
        start = time.perf_counter()
        hierarchy = agglomerate(mesh, **given)
        seconds = time.perf_counter() - start
    label = spec or str(hierarchy.statistics["bisector"])
    return _Run(label, hierarchy, summary(mesh, hierarchy), seconds)


def _data(mesh: Mesh, name: str, runs: list[_Run]) -> dict[str, Any]:
    return {
        "mesh": {"name": name, "cells": mesh.n_cells, "h0": mesh.h},
        "runs": [
            {
                "bisector": each.label,
                "levels": [_plain(level) for level in each.levels],
                "seconds": each.seconds,
                "statistics": each.hierarchy.statistics,
            }
            for each in runs
        ],
    }


def _plain(level: Mapping[str, Any]) -> dict[str, Any]:
    """A level with its target as one number: the largest diameter, or how many parts."""
    asked = level["target"]
    return {key: level[key] for key in _COLUMNS} | {"target": asked.get("h_star", asked.get("n_parts"))}


def _show(mesh: Mesh, name: str, runs: list[_Run], written: list[Path]) -> None:
    rows = []
    for each in runs:
        for level in each.levels:
            first = [each.label, f"{each.seconds:.2f} s"] if level is each.levels[0] else ["", ""]
            shown = [_wanted(level["target"]), *(number(level[key]) for key in _COLUMNS[1:])]
            rows.append([first[0], *shown, first[1]])
    title = f"{name}: {mesh.n_cells:,} cells, h0 = {number(mesh.h)}"
    print_table(title, ["bisector", *(name.replace("_", " ") for name in _COLUMNS), "time"], rows)
    for path in written:
        click.echo(f"wrote {path}")


def _wanted(target: Mapping[str, Any]) -> str:
    """A target in the words it was asked in."""
    for name, form in _WORDS.items():
        if name in target:
            return form.format(target[name])
    return "–"
