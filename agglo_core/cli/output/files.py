"""Command output files: checked before the computation, written independently of each other."""

from __future__ import annotations

import logging
import os
import re
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import click

from agglo_core.cli.output.console import say
from agglo_core.cli.output.tables import print_lines
from agglo_core.cli.stopping import find_interrupt
from agglo_core.errors import AggloError, FileError
from agglo_core.progress import Listener, phase
from agglo_core.registry import default
from agglo_core.registry.containment import PLUGIN_FAILURES, describe_error, printable

if TYPE_CHECKING:
    from agglo_core.measure.comparison import RunResult
    from agglo_core.mesh import Mesh

_log = logging.getLogger("agglo")

_PICTURES = (".png", ".pdf", ".svg")
_NO_RESULT, _NO_PICTURE = 2, 3  # exit codes


@dataclass
class Outputs:
    """A command's output files, each written independently: a failure affects no other file.

    Attributes
    ----------
    written : list of Path
    failures : list of (path, error)
        Missing files and their errors.
    code : int
        Exit code: 2 if a result is missing, else 3 if a picture or report is missing, else 0.
    """

    written: list[Path] = field(default_factory=list)
    failures: list[tuple[Path, BaseException]] = field(default_factory=list)
    code: int = 0

    def result(self, path: Path, make: Callable[[], object]) -> bool:
        """Write a result file, and return False if this failed. Interrupts propagate."""
        return self._attempt(path, make, _NO_RESULT)

    def picture(self, path: Path, make: Callable[[], object]) -> bool:
        """Write a picture or report, and return False if this failed. Interrupts propagate."""
        return self._attempt(path, make, _NO_PICTURE)

    def _attempt(self, path: Path, make: Callable[[], object], code: int) -> bool:
        try:
            make()
        except PLUGIN_FAILURES as error:
            if find_interrupt(error) is not None:
                raise
            self.failures.append((path, error))
            self.code = min(code, self.code or code)
            return False
        self.written.append(path)
        return True

    def finish(self, *, listed: bool) -> int:
        """Report the files that could not be written on stderr, and return the exit code.

        Unexpected exceptions are reported with their traceback.

        With ``listed``, also print the written files on stdout.
        """
        for path in self.written if listed else ():
            print_lines(f"wrote {path}{_coarse_meshes(path)}")
        for path, error in self.failures:
            if not isinstance(error, AggloError | OSError | ImportError | MemoryError):
                click.echo("".join(traceback.format_exception(error)), err=True, nl=False)
            reason = str(error) if isinstance(error, AggloError) else describe_error(error)
            text = reason if str(path) in reason else f"{path}: {reason}"
            say(f"error: {printable(' '.join(text.split()))}")
        return self.code


def _coarse_meshes(path: Path) -> str:
    """Return a remark on the coarse mesh files that were written beside a mesh file."""
    count = 0
    while path.with_name(f"{path.stem}_level{count}{path.suffix}").is_file():
        count += 1
    name = f"{path.stem}_level0{path.suffix}"
    return (
        ""
        if not count
        else f", and {count} coarse mesh{('es' if count > 1 else '')} in the same folder, "
        f"starting with {name}"
    )


def check_outputs(
    source: str,
    output: Path | None,
    plot: Path | None,
    report: Path | None,
    bisectors: Sequence[str],
    compress: bool = False,
) -> list[Path]:
    """Check all output files as far as possible, and return each run's mesh file.

    Raises
    ------
    FileError
        For an unknown suffix, a folder that does not exist, a path that is a folder, or the input file
        ``source``, except to add levels to a case that is a folder.
    OptionError
        If the mesh file is to be compressed, and its format does not compress.
    """
    if plot is not None:
        check_picture(plot)
    if report is not None:
        check_report(report)
    if output is None:
        return []
    from agglo_core.io import check_writable
    from agglo_core.io.formats import Formats

    files = [output] if len(bisectors) < 2 else _one_each(output, bisectors)
    for file in files:
        check_writable(file, compress=compress)
    is_case = Formats(default()).writer(output).has("folders")
    if len(files) > 1 and is_case:
        raise FileError(f"{output}: a case holds the levels of one bisector, given {' and '.join(bisectors)}")
    if not is_case:
        refuse_input(source, *files)
    return files


def refuse_input(source: str, *outputs: Path | None) -> None:
    """Raise FileError if one of the output files is the input file, which it would replace."""
    for output in outputs:
        if output is not None and output.exists() and os.path.exists(source) and output.samefile(source):
            raise FileError(f"{output} is the input file, and would be replaced: choose another output file")


def draw_runs(
    outputs: Outputs,
    mesh: Mesh,
    runs: Sequence[RunResult],
    plot: Path | None,
    report: Path | None,
    metrics: list[Any] | None,
    progress: Listener | None,
    solves: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    explode: float | None = None,
) -> None:
    """Write picture and report if requested, with means of the ``metrics`` in the titles.

    ``solves`` contains solution report data by run name.
    """
    if plot is not None:
        from agglo_core.draw.plot import draw

        hierarchies = {run.name: run.hierarchy for run in runs if run.hierarchy is not None}
        make = partial(draw, mesh, hierarchies, plot, metrics, progress=progress, explode=explode)
        outputs.picture(plot, partial(make, levels={run.name: run.levels for run in runs}))
    if report is not None:
        from agglo_core.draw.webpage import write_page

        with phase(progress, "writing", report.name):
            outputs.picture(report, lambda: write_page(report, mesh, runs, solves=solves))


def weigh_runs(outputs: Outputs, mesh: Mesh, runs: Sequence[RunResult], picture: Path) -> None:
    """Draw roundness, evenness and computing time of the runs, with their Pareto front."""
    from agglo_core.draw.pareto import draw_pareto

    name = mesh.name or "mesh"
    outputs.picture(picture, lambda: draw_pareto(runs, picture, f"{name}, {mesh.n_cells:,} cells"))


def check_report(report: Path) -> None:
    """Raise FileError if the report can foreseeably not be written to this path."""
    from agglo_core.draw.webpage import check_page

    check_page(report)


def check_picture(plot: Path, flag: str = "--plot") -> None:
    """Raise FileError if the picture can foreseeably not be written to this path.

    Without matplotlib, as needed for the option ``flag``, print an early warning.
    """
    if plot.is_dir():
        raise FileError(f"{plot} is a folder; expected a file name for the picture")
    if plot.suffix.lower() not in _PICTURES:
        raise FileError(f"{plot}: pictures end in {', '.join(_PICTURES)}, given {plot.suffix!r}")
    if not plot.parent.is_dir():
        raise FileError(f"{plot}: there is no folder {plot.parent}")
    from agglo_core.io.atomic import check_replaceable

    check_replaceable(plot)
    if find_spec("matplotlib") is None:
        text = "skipping %s, which needs matplotlib: pip install 'agglo[plot]'"
        _log.warning(text, flag)


def as_file_name(spec: str) -> str:
    """Convert a component to part of a file name: ``metis:ufactor=30`` becomes ``metis_ufactor_30``."""
    return re.sub(r"\W+", "_", spec).strip("_")


def _one_each(output: Path, bisectors: Sequence[str]) -> list[Path]:
    """Return an output file for each bisector: ``out_kmeans.vtu``, ``out_metis.vtu``.

    Options become part of the name, without characters that file names cannot have.
    """
    names = [as_file_name(spec) for spec in bisectors]
    if len(set(names)) < len(names):
        raise click.UsageError(f"{' and '.join(bisectors)} would be written to files with equal names")
    return [output.with_name(f"{output.stem}_{name}{output.suffix}") for name in names]
