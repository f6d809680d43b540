"""The paper's printed numbers, what counts as reproduced, and the reasons for what is not."""

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
    """Half-width of what counts as within band, absolute or relative to the printed number."""

    width: float
    relative: bool


@cache
def printed() -> Mapping[str, Any]:
    """Content of ``published.toml``."""
    text = files("agglo_paper.tables").joinpath("published.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def band(name: str) -> Band:
    """Band of ``uf``, ``cr``, ``ratios``, ``counts`` or ``cg``."""
    return Band(float(printed()["bands"][name]), name not in ("uf", "cr"))


def number(table: Mapping[str, Any], column: str, place: int | None = None) -> float | None:
    """The printed number of a column, if any; our `gnn` is compared with the paper's GNN."""
    value = table.get("GNN" if column == "gnn" else column)
    if value is None:
        return None
    return float(value if place is None else value[place])


def judge(cell: Cell, band: Band) -> str:
    """Verdict on a cell: equal as printed, near (by the band, or inside our own spread), or neither.

    Empty where the paper prints nothing.
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


def judged(
    table: str, name: str, cells: Mapping[str, Cell], usual: Band, others: Mapping[str, Band] | None = None
) -> Row:
    """A row with its verdict and the reasons for the cells that are not exact.

    The learned columns decide, and of the two networks the better one; METIS and CG, the references, only
    where they are alone. Verdicts that differ from it are listed after it.

    Parameters
    ----------
    table, name : str
        Which reasons apply; ``name`` heads the row.
    cells : mapping of column to Cell
    usual : Band
    others : mapping of column to Band, optional
        Where another band holds.
    """
    verdicts = {column: judge(cell, (others or {}).get(column, usual)) for column, cell in cells.items()}
    verdicts = {column: verdict for column, verdict in verdicts.items() if verdict}
    networks = [verdicts[column] for column in _NETWORKS if column in verdicts]
    deciding = [verdicts["k-means"]] if "k-means" in verdicts else []
    deciding += [_first((EXACT, NEAR, NOT), networks)] if networks else []
    verdict = _first((NOT, NEAR, EXACT), deciding or verdicts.values())
    rest = [f"{column} {each}" for column, each in verdicts.items() if each != verdict]
    differing = [column for column, each in verdicts.items() if each != EXACT]
    why = _reasons(table, name, differing)
    return Row(name, cells, f"{verdict} ({', '.join(rest)})" if rest else verdict, why)


def _first(order: Iterable[str], given: Iterable[str]) -> str:
    known = set(given)
    return next((each for each in order if each in known), "")


def _reasons(table: str, row: str, columns: Iterable[str]) -> list[str]:
    asked = set(columns)
    return [
        each["text"]
        for each in printed()["reasons"]
        if table in each.get("tables", [table])
        and row in each.get("rows", [row])
        and asked & set(each.get("columns", asked))
    ]
