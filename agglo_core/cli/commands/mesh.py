"""``agglo mesh``: write a sample mesh to a file."""

from __future__ import annotations

from pathlib import Path

import click

from agglo_core.cli.options.agglomeration import FILE
from agglo_core.cli.options.completion import samples as sample_names
from agglo_core.cli.options.shared import threads_option
from agglo_core.cli.output.console import quieten
from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.output.tables import print_lines
from agglo_core.cli.runs import show_progress
from agglo_core.progress import phase


@click.command(cls=OwnCommand, short_help="Write a sample mesh to a file.")
@click.argument("sample", shell_complete=sample_names)
@click.option("-o", "--output", required=True, type=FILE, help="File to write.")
@threads_option
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def mesh(sample: str, output: Path, quiet: bool) -> None:
    """Write SAMPLE (squares:n=64, voronoi:n=5000,seed=3, paper:triangles, …) to a file."""
    if quiet:
        quieten()
    from agglo_core import io, samples

    io.check_writable(output)
    if Path(sample).is_file():
        raise click.UsageError(
            f"{sample} is an existing file, and this command writes samples only; convert "
            f"it in Python: agglo.write({str(output)!r}, agglo.read({sample!r}))"
        )
    with show_progress(quiet) as progress:
        with phase(progress, "making the mesh", sample):
            sample_mesh = samples.from_spec(sample)
        io.write(output, sample_mesh, progress=progress)
    if not quiet:
        print_lines(f"wrote {output}: {sample_mesh.n_cells:,} cells, {sample_mesh.n_points:,} points")
