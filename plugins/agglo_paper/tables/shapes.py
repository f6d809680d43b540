"""Tables with uniformity factor and circle ratio on the paper's meshes (paper, section 4)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from agglo_paper.tables.published import band, judge_row, number, published_values
from agglo_paper.tables.record import Cell, Page, Row, Table
from agglo_paper.work.grids import GRIDS
from agglo_paper.work.measures import measure
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Data, Results, Unit
from agglo_paper.work.strategies import Strategy

_INTRO = {
    "uf": "Uniformity factor UF: diameter over the largest diameter, mean over the agglomerates. It rises "
    "when the largest diameter shrinks, so the number of agglomerates K and their mean diameter over h* "
    "stand beside it.",
    "cr": "Circle ratio: radius of the largest inscribed circle over half the diameter, mean over the "
    "agglomerates. The paper defines it with the circle anywhere in the agglomerate (CR) and prints it with "
    "the circle at the centroid (CRc): its numbers are compared with CRc.",
}


def unit(source: str, convention: str, strategy: Strategy, repeat: int = 0) -> Unit:
    """Return the computation of agglomerate shapes for a method on one mesh.

    ``repeat`` renumbers the cells or changes the seed.
    """
    settings: Data = {"source": source, "convention": convention, "strategy": strategy.data()}
    if repeat and strategy.varies:
        settings["numbering" if strategy.varies == "numbering" else "seed"] = repeat
    return Unit(measure, settings, (strategy.package,))


def repeats(plan: Plan, strategy: Strategy) -> range:
    """Return the repetition numbers for a method, a single number if its result never varies."""
    return range(1, plan.repeats + 1) if strategy.varies else range(1)


def units(plan: Plan, sources: Sequence[str] = (), conventions: Sequence[str] = ()) -> Iterator[Unit]:
    """Yield all computations for the pages ``uf`` and ``cr``."""
    for source in sources or [f"paper:{grid}" for grid in GRIDS]:
        for strategy in plan.usable:
            for convention in conventions or ("run", "text"):
                for repeat in repeats(plan, strategy):
                    yield unit(source, convention, strategy, repeat)


def cell(
    plan: Plan,
    results: Results,
    strategy: Strategy,
    source: str,
    convention: str,
    name: str,
    paper: float | None = None,
) -> Cell:
    """Return the mean of a metric as a table entry: median and range over repetitions.

    The metric may also be K or ``diameter``.
    """
    if strategy.problem:
        return Cell(None, paper)
    found = [results[unit(source, convention, strategy, repeat).key] for repeat in repeats(plan, strategy)]
    values = [float(np.mean(each[name])) for each in found if "error" not in each]
    if not values:
        return Cell(None, paper)
    if len(values) == 1:
        return Cell(values[0], paper)
    return Cell(float(np.median(values)), paper, min(values), max(values))


def notes(plan: Plan) -> list[str]:
    """Return the notes below the tables."""
    return [
        "paper / ours; where the result hangs on the numbering of the cells or on a seed, ours is the median "
        f"and (lowest–highest) of {plan.repeats}",
        *plan.problems(),
    ]


def ratio(above: Cell, below: Cell, paper: float | None) -> Cell:
    """Return the quotient of two table entries, with the range of possible values."""
    if above.ours is None or not below.ours:
        return Cell(None, paper)
    low, high = (c if c is not None else below.ours for c in (below.low, below.high))
    least, most = (c if c is not None else above.ours for c in (above.low, above.high))
    return Cell(above.ours / below.ours, paper, least / high, most / low)


def page(plan: Plan, results: Results, name: str) -> Page:
    """Return the result page ``uf`` or ``cr``."""
    metric = {"uf": "UF", "cr": "CRc"}[name]
    tables = [
        _as_printed(plan, results, name, metric),
        _relative(plan, results, name, metric),
        _bisector_table(
            plan, results, f"{name}-ours", f"{metric} of every installed bisector", metric, "run"
        ),
    ]
    if name == "cr":
        title = "CR, circle anywhere, of every installed bisector"
        tables.append(_bisector_table(plan, results, "cr-anywhere", title, "CR", "run"))
    tables += [
        _bisector_table(plan, results, f"{name}-K", "Number of agglomerates K", "K", "run", 0),
        _bisector_table(plan, results, f"{name}-diameter", "Mean diameter over h*", "diameter", "run"),
        _bisector_table(
            plan, results, f"{name}-text", f"{metric} with h* = 4 h0, as the text says", metric, "text"
        ),
        _bisector_table(plan, results, f"{name}-text-K", "K with h* = 4 h0", "K", "text", 0),
    ]
    title = {"uf": "Uniformity factor", "cr": "Circle ratio"}[name]
    convention = (
        " Sizes are h* = √2/4 on every grid, as the authors ran them; the text says 4 h0, which differs on "
        "all grids but the squares (last tables). METIS is asked for N0/16 parts."
    )
    figures = {"grids.svg": "The grids and their agglomerates", "boxes.svg": "Box plots of UF and CRc"}
    return Page(name, f"{title} of the agglomerated grids", _INTRO[name] + convention, tables, figures)


def _as_printed(plan: Plan, results: Results, name: str, metric: str) -> Table:
    rows = []
    for grid in GRIDS:
        numbers, source = published_values()[name][grid], f"paper:{grid}"
        cells = {
            each.name: cell(plan, results, each, source, "run", metric, number(numbers, each.name))
            for each in plan.compared
        }
        rows.append(judge_row(name, grid, cells, band(name)))
    return Table(name, f"{metric} as printed", rows, 4, notes=notes(plan))


def _relative(plan: Plan, results: Results, name: str, metric: str) -> Table:
    rows, table = [], f"{name}_relative"
    metis, *learned = plan.compared
    for grid in GRIDS:
        numbers, source = published_values()[table][grid], f"paper:{grid}"
        below = cell(plan, results, metis, source, "run", metric)
        cells = {}
        for each in learned:
            above = cell(plan, results, each, source, "run", metric)
            cells[each.name] = ratio(above, below, number(numbers, each.name))
        rows.append(judge_row(table, grid, cells, band("ratios")))
    return Table(table, f"{metric} relative to METIS", rows, 4, notes=notes(plan)[:1])


def _bisector_table(
    plan: Plan, results: Results, name: str, title: str, metric: str, convention: str, digits: int = 3
) -> Table:
    rows = [
        Row(each.name, {g: cell(plan, results, each, f"paper:{g}", convention, metric) for g in GRIDS})
        for each in plan.columns
    ]
    return Table(name, title, rows, digits, "bisector", [])
