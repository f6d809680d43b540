"""The four tables with multigrid and conjugate gradient iterations (paper, section 5)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from agglo_paper.tables.published import band, judge_row, number, published_values
from agglo_paper.tables.record import Cell, Page, Row, Table
from agglo_paper.tables.shapes import notes, repeats
from agglo_paper.work.measures import SETTINGS, SOLVER, count, plain
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Data, Results, Unit
from agglo_paper.work.strategies import Strategy

TABLES: Final[Mapping[str, tuple[str, str, Sequence[int]]]] = {
    "mg-levels": ("Iterations by number of levels ℓ (p = 1, m = 3)", "levels", (0, 1, 2)),
    "mg-m1": ("Iterations with one smoothing step (p = 1, m = 1, relative residual 1e-8)", "levels", (3, 4)),
    "mg-smoothing": ("Iterations by smoothing steps m (ℓ = 3, p = 1)", "steps", (1, 5)),
    "mg-degree": ("Iterations by polynomial degree p (ℓ = 3, m = 3)", "degree", (1, 6, 7)),
}
"""By command word: title, varying parameter, settings."""

_SIGNS: Final = {"levels": "ℓ", "steps": "m", "degree": "p"}


def unit(plan: Plan, grid: str, strategy: Strategy, repeat: int = 0) -> Unit:
    """Return the computation of all iteration counts for a method on one of the paper's meshes."""
    wanted = [i for i, each in enumerate(SETTINGS) if each.degree <= plan.degrees]
    settings: Data = {"source": f"paper:{grid}", "strategy": strategy.data(), "settings": wanted}
    if repeat and strategy.varies:
        settings["numbering" if strategy.varies == "numbering" else "seed"] = repeat
    return Unit(count, settings, (strategy.package, plan.solver))


def plain_unit(plan: Plan, grid: str, degree: int) -> Unit:
    """Return the computation of CG iteration counts on one of the paper's meshes."""
    settings = {"source": f"paper:{grid}", "degree": degree, "tolerances": [1e-6]}
    return Unit(plain, settings, (plan.solver,))


def units(plan: Plan) -> Iterator[Unit]:
    """Yield all computations of iteration counts for the four tables."""
    for grid in plan.grids if plan.solver else ():
        yield from (plain_unit(plan, grid, degree) for degree in range(1, plan.degrees + 1))
        for strategy in plan.usable:
            yield from (unit(plan, grid, strategy, repeat) for repeat in repeats(plan, strategy))


def page(plan: Plan, results: Results, name: str) -> Page:
    """Return the page for one of the four tables, a key of :data:`TABLES`."""
    title, _, _ = TABLES[name]
    tables = [_table(plan, results, name, as_printed) for as_printed in (True, False)]
    if not plan.solver:
        return Page(name, title, f"The solver {SOLVER} cannot be used here: see `agglo plugins`.", [])
    tolerance = "1e-8" if name == "mg-m1" else "1e-6"
    intro = (
        "V-cycles of the paper on its four grids with f = 8 (the text has 2π² sin πx sin πy, with which the "
        f"printed counts of CG cannot be had), from u = 0 to a relative residual of {tolerance}. Levels: "
        "largest diameters √2/8, √2/4, √2/2; METIS: N0/4, N0/16, N0/64 parts, which do not nest. METIS has "
        "fewer, larger agglomerates than the others at every level; `metis` and `metis k-way` among every "
        "installed bisector are held to the same diameters."
    )
    if name == "mg-m1":
        intro += " The counts of CG, printed and ours, belong to 1e-6."
    return Page(name, title, intro, tables)


def _table(plan: Plan, results: Results, name: str, as_printed: bool) -> Table:
    title, varies, indices = TABLES[name]
    rows = []
    # 1. A row per grid and setting
    for grid in plan.grids:
        for index in indices:
            setting = SETTINGS[index]
            if setting.degree > plan.degrees:
                continue
            label = f"{grid}, {_SIGNS[varies]} = {getattr(setting, varies)}"
            strategies = plan.compared if as_printed else plan.others
            cells = {strategy.name: _cell(plan, results, grid, strategy, index) for strategy in strategies}
            if as_printed:
                cells["CG"] = _plain(plan, results, grid, setting.degree)
                row = judge_row(name, grid, cells, band("counts"), {"CG": band("cg")})
                rows.append(replace(row, name=label))
            else:
                rows.append(Row(label, cells))
    # 2. Table with notes
    if not as_printed:
        return Table(f"{name}-ours", f"{title}: every other bisector", rows, 0)
    starred = (
        "\\* not converged: multigrid in some of the repetitions, which are left out; CG within 10,000 "
        "iterations, the number is that of the smallest residual"
    )
    return Table(name, f"{title}: as printed", rows, 0, notes=[*notes(plan), starred])


def _cell(plan: Plan, results: Results, grid: str, strategy: Strategy, index: int) -> Cell:
    paper = number(published_values()["multigrid"][grid], strategy.name, index)
    if strategy.problem or not plan.solver:
        return Cell(None, paper)
    found = [results[unit(plan, grid, strategy, repeat).key] for repeat in repeats(plan, strategy)]
    runs = [(each["iterations"][index], each["converged"][index]) for each in found if "error" not in each]
    values = [float(n) for n, converged in runs if converged]
    flag = "" if len(values) == len(runs) else "\\*"
    if not values:
        return Cell(None, paper, flag=flag)
    many = len(values) > 1
    return Cell(
        float(np.median(values)), paper, min(values) if many else None, max(values) if many else None, flag
    )


def _plain(plan: Plan, results: Results, grid: str, degree: int) -> Cell:
    paper = float(published_values()["multigrid"][grid]["CG"][degree - 1])
    result = results.get(plain_unit(plan, grid, degree).key, {"error": "no solver"})
    if "error" in result:
        return Cell(None, paper)
    first = result["iterations"][0]
    if first is None:
        return Cell(float(result["smallest"]), paper, flag="\\*")
    return Cell(float(first), paper)
