"""Run times of one bisection and a full recursion (paper, section 4.2)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from agglo_paper.tables.published import published_values
from agglo_paper.tables.record import Cell, Page, Row, Table
from agglo_paper.work.plan import Plan
from agglo_paper.work.store import Results, Unit
from agglo_paper.work.timing import time_one

KINDS: Final = ("bisection", "recursion")
_AT = 5000  # number of cells for the paper's ratios
_INTRO = (
    "CPU milliseconds on one thread, median and (lowest–highest), Voronoi meshes, dual graph built before "
    "the clock starts, everything compiled and imported, all methods in one process. A name alone is the "
    "component itself; `whole` adds what a run needs besides: order, refinement, repair. *METIS, raw* is one "
    "call of pymetis on the CSR arrays; *METIS through networkx* converts a networkx graph first, as the "
    "paper timed it; *GNN, forward* is the paper's network with its input features, in single precision. "
    "Below, full recursions to about 16 cells per agglomerate. Timings differ from machine to machine, "
    "ratios less."
)


def _timed_bisectors(plan: Plan) -> list[str]:
    return list(
        dict.fromkeys(
            each.bisector for each in plan.usable if each.method == "recursive" and not each.by_count
        )
    )


def unit(plan: Plan, kind: str, cells: int) -> Unit:
    """Return the measurement of run times on one mesh."""
    settings = {
        "kind": kind,
        "cells": cells,
        "bisectors": _timed_bisectors(plan),
        "runs": plan.runs,
        "seconds": plan.seconds,
    }
    return Unit(time_one, settings, tuple(each.package for each in plan.usable))


def units(plan: Plan) -> Iterator[Unit]:
    """Yield all run time measurements."""
    for kind in KINDS:
        yield from (unit(plan, kind, cells) for cells in plan.cells)


def curves(plan: Plan, results: Results, kind: str) -> Mapping[str, list[tuple[int, Cell]]]:
    """Return each method's run times in milliseconds for all cell counts."""
    lines: dict[str, list[tuple[int, Cell]]] = {}
    for cells in plan.cells:
        for name, taken in results[unit(plan, kind, cells).key].get("seconds", {}).items():
            ms = 1e3 * np.array(taken)
            cell = Cell(float(np.median(ms)), None, float(ms.min()), float(ms.max()))
            lines.setdefault(name, []).append((cells, cell))
    return lines


def page(plan: Plan, results: Results) -> Page:
    """Return the result page ``runtime``."""
    tables = [_claim(plan, results)]
    for kind, title in zip(KINDS, ("One bisection", "Full recursion"), strict=True):
        shown = [n for n in plan.cells if n in (25, 500, 1000, 2500, 5000, 20_000, 100_000)]
        rows = [
            Row(name, {f"{n:,} cells": cell for n, cell in line if n in shown})
            for name, line in curves(plan, results, kind).items()
        ]
        tables.append(Table(f"runtime-{kind}", f"{title}, CPU ms", rows, 3, "method", plan.problems()))
    figures = {"runtime.svg": "CPU time by number of cells, logarithmic scales"}
    return Page("runtime", "Runtime", _INTRO, tables, figures)


def _claim(plan: Plan, results: Results) -> Table:
    """Return ratios of METIS and k-means run times to the network's, as the paper claims for 5000 cells."""
    # 1. Median times at the largest size up to 5000 cells
    at = max(n for n in plan.cells if n <= _AT)
    lines = curves(plan, results, "bisection")
    times = {name: cell.ours for name, line in lines.items() for n, cell in line if n == at}
    rows = []
    # 2. Ratios to each network, beside the printed ones
    for fast in ("GNN, forward", "gnn_paper", "gnn"):
        pairs = (
            ("METIS through networkx", "METIS through networkx", published_values()["runtime"]["METIS"]),
            ("METIS, raw", "METIS, raw", None),
            ("k-means, 1 start", "k-means, 1 start", None),
            ("k-means, 10 starts", "k-means, 10 starts", published_values()["runtime"]["k-means"]),
        )
        cells = {}
        for head, slow, paper in pairs:
            above, below = times.get(slow), times.get(fast)
            quotient = above / below if above and below else None
            cells[head] = Cell(quotient, paper if fast == "GNN, forward" else None)
        rows.append(Row(fast, cells))
    title = (
        f"How many times longer others take than the network, one bisection of {at:,} cells (paper / ours)"
    )
    return Table("runtime-claim", title, rows, 2, "network")
