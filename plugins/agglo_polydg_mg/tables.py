"""The paper's multigrid counts (its tables of section 5) beside ours."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from math import sqrt
from typing import Final

import click

from agglo_core import Hierarchy, Mesh, agglomerate, samples
from agglo_core.problem import Diffusion
from agglo_polydg_mg.cycle import conjugate_gradients
from agglo_polydg_mg.operators import Discretisation
from agglo_polydg_mg.paper import PaperMultigrid

__all__ = ["GRIDS", "SETTINGS", "Count", "Setting", "counts", "levels_of", "paper_counts"]


@dataclass(frozen=True)
class Setting:
    """Levels ℓ, smoothing steps m, degree p, and the tolerance the published counts belong to."""

    levels: int
    steps: int
    degree: int
    tolerance: float = 1e-6


@dataclass(frozen=True)
class Count:
    """Iterations of one setting on one grid; ``paper`` are the published ones, None if there are none.

    ``strategy`` is a bisector, or ``cg`` for plain conjugate gradients.
    """

    grid: str
    strategy: str
    setting: Setting
    iterations: int
    converged: bool
    paper: int | None


SETTINGS: Final = (
    Setting(2, 3, 1),
    Setting(3, 3, 1),
    Setting(4, 3, 1),
    Setting(3, 1, 1, 1e-8),
    Setting(4, 1, 1, 1e-8),
    Setting(3, 5, 1),
    Setting(3, 3, 2),
    Setting(3, 3, 3),
)
GRIDS: Final = ("triangles", "random", "voronoi", "squares")
_PAPER: Final = {
    ("triangles", "metis"): (21, 21, 21, 230, 227, 10, 49, 63),
    ("triangles", "kmeans"): (9, 9, 9, 67, 66, 5, 10, 17),
    ("triangles", "gnn"): (9, 9, 9, 67, 66, 5, 10, 17),
    ("random", "metis"): (46, 46, 46, 706, 708, 20, 89, 115),
    ("random", "kmeans"): (41, 41, 41, 551, 577, 18, 76, 102),
    ("random", "gnn"): (32, 32, 32, 405, 407, 15, 53, 64),
    ("voronoi", "metis"): (19, 19, 19, 154, 154, 10, 36, 39),
    ("voronoi", "kmeans"): (16, 16, 16, 143, 143, 8, 25, 33),
    ("voronoi", "gnn"): (15, 15, 15, 129, 131, 8, 25, 27),
    ("squares", "metis"): (20, 20, 20, 178, 180, 9, 45, 46),
    ("squares", "kmeans"): (17, 17, 17, 162, 162, 8, 34, 52),
    ("squares", "gnn"): (17, 17, 17, 162, 162, 8, 34, 52),
}
_PAPER_CG: Final = {
    "triangles": (114, 355, 1101),
    "random": (655, 4425, 9893),
    "voronoi": (348, 987, 3235),
    "squares": (109, 365, 703),
}


def levels_of(mesh: Mesh, bisector: str, seed: int = 0) -> Hierarchy:
    """The coarse levels of the experiments: what the authors ran, not what the text says.

    Largest diameters √2/8, √2/4, √2/2 on every grid. METIS is told of the graph alone, without weights,
    and wanted a quarter, a sixteenth and a sixty-fourth of the cells, each level by a k-way call of its
    own: they do not nest.
    """
    if bisector == "metis":
        return agglomerate(
            mesh,
            bisector=("metis", {"vertex_weights": False, "edge_weights": False}),
            method="kway",
            nested=False,
            refiners=(),
            n_parts=[mesh.n_cells // 4, mesh.n_cells // 16, mesh.n_cells // 64],
            seed=seed,
        )
    return agglomerate(mesh, bisector=bisector, h_star=[sqrt(2) / 8, sqrt(2) / 4, sqrt(2) / 2], seed=seed)


def counts(grid: str, bisectors: Sequence[str]) -> Iterator[Count]:
    """Yield the counts of one of the paper's grids: multigrid with each bisector, then plain CG."""
    mesh, problem = samples.paper(grid), Diffusion(source=8.0)
    for bisector in bisectors:
        hierarchy = levels_of(mesh, bisector)
        published = _PAPER.get((grid, bisector), (None,) * len(SETTINGS))
        for setting, wanted in zip(SETTINGS, published, strict=True):
            solver = PaperMultigrid(
                setting.degree, setting.steps, setting.levels, tolerance=setting.tolerance
            )
            found = solver.solve(problem, hierarchy)
            yield Count(grid, bisector, setting, found.iterations, found.converged, wanted)
    for degree, wanted in enumerate(_PAPER_CG[grid], 1):
        system = Discretisation(degree, 10.0, scaled_basis=False)(mesh, problem)
        history = conjugate_gradients(system.A, system.b)
        yield Count(grid, "cg", Setting(1, 0, degree), history.iterations, history.converged, wanted)


@click.command("paper-counts")
@click.option("--grid", "grids", multiple=True, type=click.Choice(GRIDS), help="Default all; repeatable.")
@click.option("--bisector", "bisectors", multiple=True, metavar="NAME", help="Default kmeans and metis.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
def paper_counts(grids: tuple[str, ...], bisectors: tuple[str, ...], as_json: bool) -> None:
    """Iterations of the paper's multigrid and of plain conjugate gradients, ours beside the paper's.

    Where the partition is unique the counts agree exactly: triangles and squares with kmeans.
    """
    found = [each for grid in grids or GRIDS for each in counts(grid, bisectors or ("kmeans", "metis"))]
    if as_json:
        click.echo(json.dumps([asdict(each) for each in found], indent=2))
        return
    click.echo(
        f"{'grid':<10} {'strategy':<10} {'l':>2} {'m':>2} {'p':>2} {'tol':>6} {'ours':>7} {'paper':>6}"
    )
    for each in found:
        s, ours = each.setting, f"{each.iterations}{'' if each.converged else '*'}"
        levels, steps = ("", "") if each.strategy == "cg" else (s.levels, s.steps)
        click.echo(
            f"{each.grid:<10} {each.strategy:<10} {levels:>2} {steps:>2} {s.degree:>2} {s.tolerance:>6.0e} "
            f"{ours:>7} {each.paper or '–':>6}"
        )
    if not all(each.converged for each in found):
        click.echo("* not converged: the iterate of smallest residual")
