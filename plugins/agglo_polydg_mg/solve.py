"""``agglo solve``: agglomerate, solve a diffusion problem, report."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from agglo_core import OptionError, agglomerate
from agglo_core.arrays import Float
from agglo_core.cli.arguments import COMPONENT, FILE, agglomeration_options, choice, load_mesh, parse_spec
from agglo_core.hierarchy import Hierarchy
from agglo_core.io import check_writable
from agglo_core.kernels.first_run import first_use
from agglo_core.registry import default
from agglo_polydg_mg.basis import Basis
from agglo_polydg_mg.operators import Discretisation
from agglo_polydg_mg.output import write_solution
from agglo_polydg_mg.picture import check_picture, draw_solution
from agglo_polydg_mg.plain_cg import PlainCG
from agglo_polydg_mg.problem_file import named_problem
from agglo_polydg_mg.report import report, text

__all__ = ["solve"]

_NOT_CONVERGED = 3
_log = logging.getLogger("agglo")


@click.command(short_help="Solve a diffusion problem with PolyDG and multigrid.")
@click.argument("source", metavar="MESH|SAMPLE")
@click.option("--solver", default="polydg_mg_paper", show_default=True, metavar=COMPONENT)
@click.option("--bisector", metavar=COMPONENT, help="How a piece is split (default kmeans).")
@click.option("--method", type=click.Choice(["recursive", "kway"]), help="Default recursive.")
@click.option("--nested/--not-nested", default=None, help="Whether levels coarsen each other (default).")
@agglomeration_options
@click.option("--levels", type=int, help="Use the first so many of mesh, level 0, 1, … (default all).")
@click.option("--degree", type=int, help="Of the polynomials, 1..6 (default: the solver's).")
@click.option("--smoothing-steps", type=int, help="Before and after each coarse correction.")
@click.option("--tol", "tolerance", type=float, help="Residual relative to the right-hand side.")
@click.option("--problem", default="constant", show_default=True, metavar="constant|sine|FILE.toml")
@click.option(
    "--cg/--no-cg", default=True, help="Count the iterations of plain CG too (default; slow if large)."
)
@click.option("-o", "--output", type=FILE, help="The solution, sampled in every cell (.vtu).")
@click.option("--plot", type=FILE, help="Picture of the solution (.png, .pdf, .svg).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
def solve(
    source: str,
    solver: str,
    bisector: str | None,
    method: str | None,
    nested: bool | None,
    agglomeration: Mapping[str, Any],
    levels: int | None,
    degree: int | None,
    smoothing_steps: int | None,
    tolerance: float | None,
    problem: str,
    cg: bool,
    output: Path | None,
    plot: Path | None,
    as_json: bool,
) -> int:
    """Solve −∇·(κ∇u) = f on a mesh file or a sample: squares:n=64, voronoi:n=5000, paper:triangles, …

    constant is f = 8, sine f = 2π² sin πx sin πy, both with u = 0 on the boundary; a TOML file holds
    numbers by cell tag and boundary tag. Exit code 3: not converged.
    """
    options = {"levels": levels, "degree": degree, "smoothing_steps": smoothing_steps, "tolerance": tolerance}
    tool = _solver(solver, _given(options))
    chosen = choice("bisector", bisector) if bisector else None
    how_coarse = {**agglomeration, **_given({"bisector": chosen, "method": method, "nested": nested})}
    how: Discretisation | None = getattr(tool, "discretisation", None)
    _check_files(output, plot, how, solver)
    if first_use():
        _log.info("compiling the numerical kernels, once on this machine (about a minute)")
    asked, mesh = named_problem(problem, load_mesh(source))
    basis = how.basis(mesh) if how else None  # refuses a mesh in 3-D before it is agglomerated
    plain = isinstance(tool, PlainCG)  # needs no levels, but what is asked of them is looked at
    levelless = Hierarchy(mesh, mesh.graph, [], [], nested=True)
    hierarchy = levelless if plain and not how_coarse else agglomerate(mesh, **how_coarse)
    solution = tool.solve(asked, hierarchy)
    data = report(mesh, asked, solution, how, getattr(tool, "tolerance", 1e-6) if cg and not plain else None)
    written = _write(basis, solution.x, output, plot)
    if as_json:
        if cg and plain and solution.converged:
            data["cg_iterations"] = solution.iterations
        click.echo(json.dumps(_finite(data), indent=2, allow_nan=False))
    else:
        click.echo("\n".join([text(f"{mesh.name or source}, {solver}", data), *written]))
    return 0 if solution.converged else _NOT_CONVERGED


def _given(options: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}


def _solver(spec: str, given: Mapping[str, Any]) -> Any:
    name, options = parse_spec(spec)
    twice = sorted(set(options) & set(given))
    if twice:
        raise OptionError(f"{twice[0]} is given twice: in --solver {spec} and by an option of its own")
    return default().build("solver", name, **options, **given)


def _check_files(output: Path | None, plot: Path | None, how: Discretisation | None, solver: str) -> None:
    """Find out before anything is computed."""
    if (output or plot) and how is None:
        raise OptionError(f"{solver} does not say what its unknowns mean: -o and --plot are not available")
    if output is not None:
        if output.suffix.lower() != ".vtu":
            raise OptionError(f"{output}: a solution is written as .vtu")
        check_writable(output)
    if plot is not None:
        check_picture(plot)


def _write(basis: Basis | None, x: Float, output: Path | None, plot: Path | None) -> list[str]:
    """Leave the files asked for, the picture first: a failed one leaves no other file behind."""
    if basis is None:
        return []
    if plot is not None:
        draw_solution(plot, basis, x)
    if output is not None:
        write_solution(output, basis, x)
    return [f"wrote {path}" for path in (output, plot) if path is not None]


def _finite(value: Any) -> Any:
    """``value`` as JSON knows it: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
