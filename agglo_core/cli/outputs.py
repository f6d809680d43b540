"""Output files of the commands: checked before anything is computed, written at the end."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.errors import FileError, OptionError

if TYPE_CHECKING:
    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh

__all__ = [
    "as_file_name",
    "check_outputs",
    "check_picture",
    "check_report",
    "refuse_3d_meshes",
    "write_outputs",
]

_PICTURES = (".png", ".pdf", ".svg")


def check_outputs(
    output: Path | None, plot: Path | None, report: Path | None, bisectors: Sequence[str]
) -> list[Path]:
    """The mesh file of each run, all writable as far as can be told in advance.

    Raises
    ------
    FileError
        For an unknown suffix, a folder that does not exist, or a path that is a folder.
    OptionError
        If a picture is asked for and matplotlib is not installed.
    """
    if plot is not None:
        check_picture(plot)
    if report is not None:
        check_report(report)
    if output is None:
        return []
    from agglo_core.io import check_writable

    files = [output] if len(bisectors) < 2 else _one_each(output, bisectors)
    for file in files:
        check_writable(file)
    return files


def check_report(report: Path) -> None:
    """Raise FileError unless a report can be written there, as far as can be told in advance."""
    from agglo_core.draw.webpage import check_page

    check_page(report)


def refuse_3d_meshes(mesh: Mesh, source: str, wanted: Mapping[str, Path | None]) -> None:
    """Raise OptionError if a picture of a 3-D mesh is wanted; ``wanted`` is by option."""
    flags = [flag for flag, path in wanted.items() if path is not None]
    if flags and mesh.dim != 2:
        name = mesh.name or source
        verb = "draws" if len(flags) == 1 else "draw"
        raise OptionError(f"{' and '.join(flags)} {verb} plane meshes; {name} is {mesh.dim}-dimensional")


def check_picture(plot: Path) -> None:
    """Raise FileError unless a picture can be written there, as far as can be told in advance.

    Raises OptionError without matplotlib.
    """
    if plot.is_dir():
        raise FileError(f"{plot} is a folder; expected the name of a picture")
    if plot.suffix.lower() not in _PICTURES:
        raise FileError(f"{plot}: pictures end in {', '.join(_PICTURES)}, not {plot.suffix!r}")
    if not plot.parent.is_dir():
        raise FileError(f"{plot}: there is no folder {plot.parent}")
    if find_spec("matplotlib") is None:
        raise OptionError("--plot needs matplotlib, which is not installed: pip install 'agglo[plot]'")


def as_file_name(spec: str) -> str:
    """A component as part of a file name: ``metis:ufactor=30`` becomes ``metis_ufactor_30``."""
    return re.sub(r"\W+", "_", spec).strip("_")


def _one_each(output: Path, bisectors: Sequence[str]) -> list[Path]:
    """``out_kmeans.vtu``, ``out_metis.vtu``; options become part of the name as far as file names allow."""
    names = [as_file_name(spec) for spec in bisectors]
    if len(set(names)) < len(names):
        raise click.UsageError(f"{' and '.join(bisectors)} would be written to files of the same name")
    return [output.with_name(f"{output.stem}_{name}{output.suffix}") for name in names]


def write_outputs(
    mesh: Mesh,
    runs: Sequence[RunResult],
    files: Sequence[Path],
    plot: Path | None,
    report: Path | None,
    metrics: list[Any] | None = None,
) -> list[Path]:
    """Write what was asked for and return the paths; a failed picture leaves no mesh file behind.

    ``metrics`` are those whose means stand in the titles of the picture.
    """
    written = []
    done = {run.name: run.hierarchy for run in runs if run.hierarchy is not None}
    if plot is not None:
        from agglo_core.draw.plot import draw

        draw(mesh, done, plot, metrics)
        written.append(plot)
    if report is not None:
        from agglo_core.draw.webpage import write_page

        write_page(report, mesh, runs)
        written.append(report)
    if files:
        from agglo_core.io import write

        finished = [run for run in runs if run.hierarchy is not None]
        for file, run in zip(files, finished, strict=True):
            write(file, mesh, run.hierarchy, level_values=[level.values for level in run.levels])
            written.append(file)
    return written
