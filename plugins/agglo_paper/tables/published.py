"""The numbers printed in the paper, rules for verdicts on agglo's, and reasons for differences."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any, Final, NamedTuple

from agglo_paper.tables.record import Cell, Row

EXACT: Final = "reproduced"
NEAR: Final = "within band"
NOT: Final = "not reproduced"
_PRECISION: Final = 6e-5  # the paper prints four digits
_NETWORKS: Final = ("GNN", "gnn")


class Band(NamedTuple):
    """Accepted deviation from the printed number, absolute or relative to it."""

    width: float
    relative: bool


@cache
def published_values() -> Mapping[str, Any]:
    """Read the published numbers from ``published.toml``."""
    text = files("agglo_paper.tables").joinpath("published.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def band(name: str) -> Band:
    """Return the accepted deviation for ``uf``, ``cr``, ``ratios``, ``counts`` or ``cg``."""
    return Band(float(published_values()["bands"][name]), name not in ("uf", "cr"))


def number(table: Mapping[str, Any], column: str, place: int | None = None) -> float | None:
    """Return the printed number for a column, or None if the paper prints none.

    `gnn` is compared with the paper's GNN.
    """
    value = table.get("GNN" if column == "gnn" else column)
    if value is None:
        return None
    return float(value if place is None else value[place])


def judge(cell: Cell, band: Band) -> str:
    """Return the verdict on a number: equal as printed, near, or neither.

    Near is within the accepted deviation, or with the printed number in the range over repetitions.

    Returns an empty text if the paper prints nothing.
    """
    if cell.paper is None:
        return ""
    if cell.ours is None:
        return NOT
    if abs(cell.ours - cell.paper) <= _PRECISION and not cell.flag:
        return EXACT
    width = band.width * cell.paper if band.relative else band.width
    low, high = (cell.ours if end is None else end for end in (cell.low, cell.high))
    near = abs(cell.ours - cell.paper) <= width or low <= cell.paper <= high
    return NEAR if near else NOT


def judge_row(
    table: str, name: str, cells: Mapping[str, Cell], usual: Band, others: Mapping[str, Band] | None = None
) -> Row:
    """Return a table row with its verdict, and the reasons for all deviations.

    The learned columns decide, with the better network of the two; the references METIS and CG decide only
    if they are alone. Deviating verdicts are listed after the main verdict.

    Parameters
    ----------
    table, name : str
        Table and row heading, which select the reasons.
    cells : mapping of column to Cell
    usual : Band
    others : mapping of column to Band, optional
        Bands for special columns.
    """
    # 1. Verdict of each column
    verdicts = {column: judge(cell, (others or {}).get(column, usual)) for column, cell in cells.items()}
    verdicts = {column: verdict for column, verdict in verdicts.items() if verdict}
    # 2. Deciding columns
    networks = [verdicts[column] for column in _NETWORKS if column in verdicts]
    deciding = [verdicts["k-means"]] if "k-means" in verdicts else []
    deciding += [_first((EXACT, NEAR, NOT), networks)] if networks else []
    verdict = _first((NOT, NEAR, EXACT), deciding or verdicts.values())
    # 3. Deviating verdicts and reasons
    deviations = [f"{column} {v}" for column, v in verdicts.items() if v != verdict]
    differing = [column for column, v in verdicts.items() if v != EXACT]
    reasons = _reasons(table, name, differing)
    return Row(name, cells, f"{verdict} ({', '.join(deviations)})" if deviations else verdict, reasons)


def _first(order: Iterable[str], given: Iterable[str]) -> str:
    known = set(given)
    return next((each for each in order if each in known), "")


def _reasons(table: str, row: str, columns: Iterable[str]) -> list[str]:
    column_set = set(columns)
    return [
        reason["text"]
        for reason in published_values()["reasons"]
        if table in reason.get("tables", [table])
        and row in reason.get("rows", [row])
        and column_set & set(reason.get("columns", column_set))
    ]
