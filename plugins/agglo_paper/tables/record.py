"""Data structures for the results: numbers of agglo and the paper, rows with a verdict, tables, pages."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class Cell:
    """One table entry: a number from agglo and from the paper, with agglo's range over repetitions.

    Attributes
    ----------
    ours, paper : float, optional
        None if there is none.
    low, high : float, optional
        Range of ours; ``ours`` is then the median.
    flag : str
        Mark after our number, explained in the table notes.
    """

    ours: float | None = None
    paper: float | None = None
    low: float | None = None
    high: float | None = None
    flag: str = ""

    def text(self, digits: int) -> str:
        """Return the entry as text: ``paper / ours (low–high)``, or ``ours`` alone."""
        number_text = _number(self.ours, digits) + self.flag
        if self.low is not None and self.high is not None and self.low < self.high:
            number_text += f" ({_number(self.low, digits)}–{_number(self.high, digits)})"
        return number_text if self.paper is None else f"{_number(self.paper, digits)} / {number_text}"


@dataclass(frozen=True)
class Row:
    """One table row: numbers or texts by column, a verdict, and reasons for deviations."""

    name: str
    cells: Mapping[str, Cell | str]
    verdict: str = ""
    why: Sequence[str] = ()


@dataclass(frozen=True)
class Table:
    """One table of a page: title, rows and notes.

    Attributes
    ----------
    name : str
        Unique key for programs.
    title : str
    rows : sequence of Row
    digits : int
        Decimal places, 0 for counts.
    corner : str
        First column heading.
    notes : sequence of str
    """

    name: str
    title: str
    rows: Sequence[Row]
    digits: int = 3
    corner: str = "grid"
    notes: Sequence[str] = ()

    @property
    def columns(self) -> list[str]:
        """Column headings, in order of appearance."""
        return list(dict.fromkeys(name for row in self.rows for name in row.cells))

    def markdown(self) -> str:
        """Return the table in Markdown, with reasons and notes below."""
        # 1. Headings, rows and marks of reasons
        judged = any(row.verdict for row in self.rows)
        heads = [self.corner, *self.columns, *(["verdict"] if judged else [])]
        reasons = list(dict.fromkeys(reason for row in self.rows for reason in row.why))
        lines = [f"### {self.title}", "", _line(heads), _line(["---"] * len(heads))]
        for row in self.rows:
            cells = [_text(row.cells.get(name, "–"), self.digits) for name in self.columns]
            marks = "".join(f" [{n}]" for n, reason in enumerate(reasons, 1) if reason in row.why)
            lines.append(_line([row.name, *cells, *([(row.verdict or "–") + marks] if judged else [])]))
        # 2. Reasons and notes
        whys = [f"- [{place}] {reason}." for place, reason in enumerate(reasons, 1)]
        notes = [f"*{note}.*" for note in self.notes]
        blocks = ["\n".join(lines), "\n".join(whys), "\n\n".join(notes)]
        return "\n\n".join(block for block in blocks if block) + "\n"


@dataclass(frozen=True)
class Page:
    """One page of results: introduction, tables, figures, failed computations."""

    name: str
    title: str
    intro: str
    tables: Sequence[Table]
    figures: Mapping[str, str] = field(default_factory=dict)  # file name to caption
    failures: Sequence[str] = ()

    def markdown(self) -> str:
        """Return the whole page in Markdown."""
        pictures = "\n".join(f"![{caption}]({name})\n" for name, caption in self.figures.items())
        failures = "\n".join(f"*{failure}.*\n" for failure in self.failures)
        tables = (table.markdown() for table in self.tables)
        parts = [f"# {self.title}\n", self.intro + "\n", failures, pictures, *tables]
        return "\n".join(part for part in parts if part)

    def data(self) -> dict[str, Any]:
        """Return the page as plain data for ``--json``."""
        tables = [_plain(asdict(table)) for table in self.tables]
        failures = {"failures": list(self.failures)} if self.failures else {}
        return {"name": self.name, "title": self.title, "tables": tables, **failures}


def _plain(value: Any) -> Any:
    """Return nested data with numbers rounded to six decimals and without empty entries."""
    if isinstance(value, Mapping):
        entries = {key: _plain(item) for key, item in value.items()}
        return {key: item for key, item in entries.items() if item not in (None, "", [])}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return value


def _number(value: float | None, digits: int) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:.{digits or int(value % 1 > 0)}f}"  # a median of counts may end in .5


def _text(cell: Cell | str, digits: int) -> str:
    return cell if isinstance(cell, str) else cell.text(digits)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
