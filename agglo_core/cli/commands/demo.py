"""``agglo demo``: agglomerate a human brain with every bisector, and write report, pictures and meshes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from agglo_core.cli.options.agglomeration import FILE
from agglo_core.cli.options.numbers import Number
from agglo_core.cli.options.shared import bisectors_option, threads_option
from agglo_core.cli.options.specs import choice
from agglo_core.cli.output.console import explain_compilation, number, print_json, quieten, say
from agglo_core.cli.output.files import Outputs, as_file_name
from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.output.tables import print_lines, print_table
from agglo_core.cli.runs import attempt, data, execute, refuse_all_failed, run_data, show, show_progress
from agglo_core.errors import FileError, PluginError
from agglo_core.progress import phase
from agglo_core.registry import Record, default

if TYPE_CHECKING:
    from agglo_core.cli.solving.electrophysiology import Wave
    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh
    from agglo_core.problems.discretisation import Samples
    from agglo_core.progress import Listener

_FIRST = ("kmeans", "metis")
_TISSUE = "tissue"
_BOXES = 2
"""Number of metrics with box plots, the first available for the mesh."""


@click.command(cls=OwnCommand, short_help="Agglomerate a sample brain with every bisector.")
@click.option(
    "-o", "--output", type=FILE, default="agglo-demo", show_default=True, help="Folder for the results."
)
@bisectors_option("How a piece is split (default: all).")
@click.option("--3d", "solid", is_flag=True, help="The whole brain in voxels; no part contains two tissues.")
@click.option(
    "--diameter-fraction",
    "factor",
    type=Number(float, above=0.0, most=1.0),
    default=0.2,
    show_default=True,
    help="Largest agglomerate diameter, relative to the brain's diameter.",
)
@click.option(
    "--electrophysiology",
    is_flag=True,
    help="A wave of excitation on the section and on its agglomerates, with p = 1, 2, 3.",
)
@threads_option
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option("--quiet", is_flag=True, help="Print nothing but errors (and JSON with --json).")
def demo(
    output: Path,
    bisectors: Sequence[str],
    solid: bool,
    factor: float,
    electrophysiology: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Agglomerate a coronal section of a human brain with every bisector, or with chosen bisectors.

    With --3d, use the whole brain in cubes of 4 mm: fluid, grey and white matter share no agglomerate.

    The table compares bisectors at --diameter-fraction. Coarser levels have twice and four times this size.
    The folder receives report.html, pictures and meshes for ParaView. Files of an earlier demo are replaced.

    With --electrophysiology, solve the monodomain equation on the triangles and on 700 agglomerates instead:
    grey and white matter, and a conductivity tensor along synthetic fibres. The table has iterations and
    time per step. The folder receives report.html, a picture, a film and the last states for ParaView.
    """
    if quiet:
        quieten()
    _check_folder(output)
    if electrophysiology:
        source = click.get_current_context().get_parameter_source("factor")
        if bisectors or solid or source is not ParameterSource.DEFAULT:
            raise click.UsageError(
                "--electrophysiology cannot be combined with --bisector, --3d or --diameter-fraction"
            )
        return _electrophysiology(output, as_json, quiet)
    bisector_choices = {spec: choice("bisector", spec) for spec in bisectors or _bisectors(quiet, solid)}
    from agglo_core import samples

    mesh = samples.brain3d() if solid else samples.brain()
    rules = {"regions": _TISSUE} if solid else {}
    diameter = float(mesh.graph.diameters()[0])
    if not quiet:
        explain_compilation()
    # Three sizes, smaller than the mesh.
    factors = [factor * times for times in (1, 2, 4) if times == 1 or factor * times < 1.0]
    sizes = tuple(diameter * fraction for fraction in factors)
    with show_progress(quiet) as progress:
        runs = [
            attempt(mesh, spec, {"bisector": bisector, "h_star": sizes, **rules}, progress=progress)
            for spec, bisector in bisector_choices.items()
        ]
        refuse_all_failed(runs)
        # Titles, then meshes, report and pictures.
        size = f"diameter D = {number(diameter)}"
        note = f"{size}; levels at h* = {', '.join(f'{fraction:g}' for fraction in factors)} D"
        note += f"; no part contains two {_TISSUE}s" if solid else ""
        title = f"{mesh.name}: {mesh.n_cells:,} cells, {size}, h* = {factor:g} D"
        output.mkdir(exist_ok=True)
        outputs = Outputs()
        _meshes(outputs, output, mesh, runs, progress)
        page = output / "report.html"
        with phase(progress, "writing", page.name):
            outputs.picture(page, lambda: _page(page, mesh, runs, note))
        _pictures(outputs, output, mesh, runs, title, quiet, progress)
    if as_json:
        records = [run_data(run, run.name, "recursive") for run in runs]
        files = sorted(outputs.written, key=lambda file: file != page)
        print_json(
            data(mesh, "brain3d" if solid else "brain", records) | {"files": [str(file) for file in files]}
        )
    elif not quiet:
        show(title, runs, only_finest=True)
        hint = f": open {page} in a browser" if page in outputs.written else ""
        print_lines(f"wrote {len(outputs.written)} files to {output}{hint}")
    return outputs.finish(listed=False)


def _electrophysiology(folder: Path, as_json: bool, quiet: bool) -> int:
    """Solve the monodomain equation on the section and on agglomerates, and write the results."""
    from agglo_core import samples
    from agglo_core.cli.solving import electrophysiology as model

    if not quiet:
        explain_compilation()
    mesh, kappa = model.brain_tissue(samples.brain())
    with show_progress(quiet) as progress:
        run = execute(mesh, "kmeans", {"cells_per_part": 20, "regions": model.TISSUE}, progress=progress)
        assert run.hierarchy is not None  # a failure is an exception
        coarse, means = model.on_agglomerates(run.hierarchy, kappa)
        meshes = {"triangles": (mesh, kappa), "agglomerates": (coarse, means)}
        waves = [
            model.wave(name, *meshes[name], degree, every, progress)
            for degree, every in ((1, model.PICTURE), (2, model.PICTURE), (3, model.FRAME))
            for name in meshes
        ]
        # Last states for ParaView, report, picture and film.
        folder.mkdir(exist_ok=True)
        outputs, page = Outputs(), folder / "report.html"
        for wave in waves[-2:]:
            file = folder / f"{wave.mesh}.vtu"
            outputs.result(file, partial(wave.last.write, file))
        costs = [f"{wave.name}: {wave.iterations:.1f} and {1e3 * wave.step_seconds:.0f} ms" for wave in waves]
        note = f"{waves[0].steps} steps, with mean iterations and CPU time per step: {'; '.join(costs)}"
        with phase(progress, "writing", page.name):
            outputs.picture(page, lambda: _page(page, mesh, [run], note))
        _wave_pictures(outputs, folder, waves, quiet, progress)
    if as_json:
        files = {"files": [str(file) for file in sorted(outputs.written, key=lambda file: file != page)]}
        print_json(data(mesh, "brain", [wave.data() for wave in waves]) | files)
    elif not quiet:
        heads = ("mesh", "cells", "p", "unknowns", "iterations", "set-up s", "ms per step", "∫ u")
        rows = [
            [
                wave.mesh,
                *map(str, (wave.cells, wave.degree, wave.unknowns)),
                f"{wave.iterations:.1f}",
                f"{wave.setup_seconds:.2f}",
                f"{1e3 * wave.step_seconds:.0f}",
                f"{wave.integral:.0f}",
            ]
            for wave in waves
        ]
        title = f"monodomain equation, {waves[0].steps} steps to t = {model.T_END:g}, CPU time"
        print_table(title, heads, rows)
        print_lines(f"wrote {len(outputs.written)} files to {folder}")
    return outputs.finish(listed=False)


def _wave_pictures(
    outputs: Outputs, folder: Path, waves: Sequence[Wave], quiet: bool, progress: Listener | None
) -> None:
    """Draw states of all waves at three times, and a film of the last wave."""
    if not _can_draw(quiet):
        return
    from agglo_core.draw.states import draw_film, draw_states

    times = list(waves[0].frames)
    rows: dict[str, list[Samples]] = {}
    for wave in waves:
        rows.setdefault(f"p = {wave.degree}", []).extend(wave.frames[t] for t in times)
    titles = [f"{wave.mesh}, t = {t:g}" for wave in waves[:2] for t in times]
    ends = (0.0, 1.0)
    picture, film = folder / "wave.png", folder / "wave.gif"
    with phase(progress, "drawing", picture.name):
        outputs.picture(picture, lambda: draw_states(picture, rows, titles, ends))
    frames = {f"{waves[-1].name}, t = {t:g}": state for t, state in waves[-1].frames.items()}
    with phase(progress, "drawing", film.name):
        outputs.picture(film, lambda: draw_film(film, frames, ends))


def _can_draw(quiet: bool) -> bool:
    """Return True if matplotlib is installed, or print a note."""
    installed = find_spec("matplotlib") is not None
    if not installed and not quiet:
        say(
            "note: only report.html has pictures, because matplotlib is not installed: "
            "pip install 'agglo[plot]'"
        )
    return installed


def _bisectors(quiet: bool, solid: bool = False) -> list[str]:
    """Return all usable bisectors, and print a note on those that lack a package or 3-D support."""
    records = [record for record in default().list() if record.kind == "bisector"]
    plane = [record for record in records if solid and record.state == "ok" and not _in_space(record)]
    for record in records if not quiet else ():
        if record.state == "needs":
            say(f"note: left out {record.name}: it {record.reason}")
        elif record in plane:
            say(f"note: left out {record.name}: it does not promise 3d")
    names = [record.name for record in records if record.state == "ok" and record not in plane]
    if not names:
        raise PluginError("no bisector can be used: see agglo plugins")
    return sorted(names, key=lambda name: _FIRST.index(name) if name in _FIRST else len(_FIRST))


def _in_space(record: Record) -> bool:
    return record.component is not None and bool(record.component.promises.get("3d"))


def _check_folder(folder: Path) -> None:
    if folder.exists() and not folder.is_dir():
        raise FileError(f"{folder} is a file; expected a folder to fill")
    if not folder.exists() and not folder.parent.is_dir():
        raise FileError(f"{folder}: there is no folder {folder.parent}")
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        raise FileError(f"{folder}: the folder is not writable")


def _meshes(
    outputs: Outputs, folder: Path, mesh: Mesh, runs: Sequence[RunResult], progress: Listener | None
) -> None:
    """Write the mesh and the levels of each run for ParaView."""
    from agglo_core.io import write

    for run in runs:
        if run.hierarchy is not None:
            fine = folder / f"{as_file_name(run.name)}.vtu"
            values = [level.values for level in run.levels]
            make = partial(write, fine, mesh, run.hierarchy, level_values=values, progress=progress)
            if outputs.result(fine, make):
                levels = range(len(run.levels))
                outputs.written += [fine.with_name(f"{fine.stem}_level{place}.vtu") for place in levels]


def _page(page: Path, mesh: Mesh, runs: Sequence[RunResult], note: str) -> None:
    from agglo_core.draw.webpage import write_page

    write_page(page, mesh, runs, note)


def _pictures(
    outputs: Outputs,
    folder: Path,
    mesh: Mesh,
    runs: Sequence[RunResult],
    title: str,
    quiet: bool,
    progress: Listener | None,
) -> None:
    """Draw the box plots, the mesh, and the levels of each run, or print a note without matplotlib."""
    if not _can_draw(quiet):
        return
    from agglo_core.draw.boxplot import draw_boxes
    from agglo_core.draw.plot import draw, draw_mesh
    from agglo_core.measure.selection import RATIOS

    # Box plots, mesh, and the levels of each run.
    values = {run.name: run.levels[0].values for run in runs if run.levels}
    boxes = folder / "boxplots.png"
    with phase(progress, "drawing", boxes.name):
        metric_names = [name for name in RATIOS if all(name in row for row in values.values())]
        outputs.picture(boxes, lambda: draw_boxes(values, boxes, metric_names[:_BOXES], title=title))
    whole = folder / "mesh.png"
    with phase(progress, "drawing", whole.name):
        outputs.picture(whole, lambda: draw_mesh(mesh, whole))
    for run in runs:
        if run.hierarchy is not None:
            picture = folder / f"{as_file_name(run.name)}.png"
            hierarchies, levels = {run.name: run.hierarchy}, {run.name: run.levels}
            make = partial(draw, mesh, hierarchies, picture, progress=progress, fine=False, levels=levels)
            outputs.picture(picture, make)
