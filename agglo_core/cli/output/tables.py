"""Tables on stdout, drawn by the package rich, with column widths that cut no number.

On a narrow terminal the layout gives up, in this order, the frame, unfolded headings and words, and spare
columns (named in a line below the table). Finally every row becomes a block of lines. In a pipe a table has
its full width and the frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from io import StringIO
from types import MappingProxyType

import click

from agglo_core.cli.output.encoding import can_show, replace_unencodable
from agglo_core.cli.output.stdout import stdout, terminal_columns

_PIPE = 200  # width for folding if the output is not a terminal
_GAP = 2  # characters between columns
_SPACES = re.compile(r"(?<= )(?=[^ ])")
_BREAKS = re.compile(r"(?<= )(?=[^ ])|(?<=[,:=_-])(?=[A-Za-z])")
_NUMBER = re.compile(r"[-+]?\d[\d,.]*(–\d+)?(e[-+]?\d+)?( %| \(.*\))?|[–-]|")
_FRAME = "┏━┳┓┃┡╇┩│└─┴┘"
_NOTHING: Mapping[str, int] = MappingProxyType({})


@dataclass(frozen=True)
class Table:
    """Table of texts with rules for narrow terminals: columns to drop, columns to fold.

    Attributes
    ----------
    columns : sequence of str
        Headings.
    rows : sequence of sequence of str
    spare : sequence of str
        Columns that may be dropped, in this order.
    fold : mapping of str to int
        Minimum widths of columns with words, which may be folded.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    spare: Sequence[str]
    fold: Mapping[str, int]

    def without(self, left: Sequence[str]) -> Table:
        """Return the table without the given columns."""
        indices = [place for place, name in enumerate(self.columns) if name not in left]
        rows = [[row[place] for place in indices] for row in self.rows]
        return replace(self, columns=[self.columns[place] for place in indices], rows=rows)

    def cells(self, place: int) -> list[str]:
        """Return the texts in the column with this index."""
        return [row[place] for row in self.rows]

    def least(self, *, whole_heads: bool) -> list[int]:
        """Return the minimum width per column, with the heading folded or in one line."""
        widths = []
        for place, name in enumerate(self.columns):
            cells = self.cells(place)
            needs = _widest(cells)
            if name in self.fold:
                needs = max(min(needs, self.fold[name]), _longest_word(cells))
            widths.append(max(needs, _width(name) if whole_heads else _longest_word([name])))
        return widths

    def widths(self, room: int, *, whole_heads: bool) -> list[int] | None:
        """Return column widths with sum at most ``room``, or None if the minimum widths exceed it."""
        widths = self.least(whole_heads=whole_heads)
        room -= sum(widths)
        if room < 0:
            return None
        for place, name in enumerate(self.columns):
            natural_width = max(_width(name), _widest(self.cells(place)))
            extra = max(0, min(room, natural_width - widths[place]))
            widths[place] += extra
            room -= extra
        return widths


def print_table(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    spare: Sequence[str] = (),
    fold: Mapping[str, int] = _NOTHING,
    boxed: bool = True,
) -> None:
    """Print a table on stdout, at most as wide as the terminal.

    Parameters
    ----------
    title : str
        Line above the table, or empty.
    columns, rows, spare, fold
        As in :class:`Table`. With spare columns, the command must have ``--json``, as a hint refers to it.
    boxed : bool
        Draw lines around the cells if they fit.

    Examples
    --------
    >>> from agglo_core.authoring import print_table
    >>> print_table("", ["bisector", "parts"], [["sweep", "8"], ["metis", "16"]], boxed=False)
    bisector  parts
    --------  -----
    sweep         8
    metis        16
    """
    table = Table(
        list(map(replace_unencodable, columns)),
        [list(map(replace_unencodable, row)) for row in rows],
        list(map(replace_unencodable, spare)),
        {replace_unencodable(name): least for name, least in fold.items()},
    )
    if title:
        print_lines(title)
    boxed = boxed and can_show(_FRAME)
    click.echo("\n".join(lay_out_table(table, terminal_columns(), boxed=boxed)), file=stdout())


def print_lines(text: str) -> None:
    """Print lines on stdout, wrapped only at spaces, so that paths are not broken.

    Examples
    --------
    >>> from agglo_core.authoring import print_lines
    >>> print_lines("8 parts\\n2 parts")
    8 parts
    2 parts
    """
    width = terminal_columns()
    for line in replace_unencodable(text).split("\n") if text else ():
        click.echo(line_for(width, line), file=stdout())


def line_for(width: int | None, line: str) -> str:
    """Return a line wrapped to the given terminal width, only at spaces."""
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return line if width is None else "\n".join(fold_text(line, width, indent, _SPACES))


def lay_out_table(table: Table, width: int | None, *, boxed: bool) -> list[str]:
    """Return the lines of a table that fits into ``width`` columns, or of full width if None."""
    count = len(table.columns)
    frame, gaps = 3 * count + 1, _GAP * (count - 1)
    # First choice: framed, with whole headings.
    if width is None:
        width = max(_PIPE, sum(table.least(whole_heads=True)) + frame)
    if boxed and (widths := table.widths(width - frame, whole_heads=True)) is not None:
        return _draw_grid(table, widths, boxed=True)
    # Then without frame, dropping spare columns one by one.
    for n_omitted in range(len(table.spare) + 1):
        omitted_columns = [name for name in table.columns if name in table.spare[:n_omitted]]
        narrow_table = table.without(omitted_columns)
        widths = narrow_table.widths(width - gaps + _GAP * len(omitted_columns), whole_heads=False)
        if widths is not None:
            full_width = sum(table.least(whole_heads=False)) + gaps
            return [
                *_draw_grid(narrow_table, widths, boxed=False),
                *(_describe_omission(omitted_columns, width, full_width) if omitted_columns else ()),
            ]
    # Last resort: a block of lines per row.
    return list(_stack_rows(table, width))


def _describe_omission(names: Sequence[str], width: int, full_width: int) -> list[str]:
    text = f"left out: {', '.join(names)}; for all columns use a terminal of {full_width} columns, or --json"
    return list(fold_text(text, width, "  "))


def _draw_grid(table: Table, widths: Sequence[int], *, boxed: bool) -> list[str]:
    """Return the lines of a table with the given column widths, drawn by the package rich."""
    from rich.box import HEAVY_HEAD
    from rich.console import Console
    from rich.table import Table as Grid
    from rich.text import Text

    # Numeric columns are aligned to the right.
    grid = Grid(
        box=HEAVY_HEAD if boxed else None,
        padding=(0, 1) if boxed else (0, _GAP, 0, 0),
        pad_edge=boxed,
        show_header=boxed,
    )
    for place, (name, width) in enumerate(zip(table.columns, widths, strict=True)):
        numeric = name not in table.fold and all(map(_NUMBER.fullmatch, table.cells(place)))
        grid.add_column(Text(name), width=width, justify="right" if numeric else "left")
    heads = () if boxed else (table.columns, ["-" * width for width in widths])  # rich would align to the top
    for row in (*heads, *table.rows):
        cells = (fold_text(cell, width) for cell, width in zip(row, widths, strict=True))
        grid.add_row(*(Text("\n".join(lines)) for lines in cells))
    page_width = sum(widths) + 4 * len(widths) + 1
    # Draw on an own stream.
    page = StringIO()  # rich draws with ASCII on a stream that is not in UTF-8
    Console(file=page, width=page_width, color_system=None, legacy_windows=False, _environ={}).print(grid)
    return [line.rstrip() for line in page.getvalue().removesuffix("\n").split("\n")]


def _stack_rows(table: Table, width: int) -> Iterator[str]:
    """Yield the rows as blocks of lines, one line per cell, for terminals too narrow for a table.

    A row with an empty first cell continues the previous block.
    """
    margin = max(map(_width, table.columns), default=0) + _GAP
    for number, row in enumerate(table.rows):
        if number and row[0]:
            yield ""
        for name, cell in zip(table.columns, row, strict=True):
            if cell:
                yield from fold_text(name + " " * (margin - _width(name)) + cell, width, " " * _GAP)


def fold_text(text: str, width: int, indent: str = "", breaks: re.Pattern[str] = _BREAKS) -> Iterator[str]:
    """Yield wrapped lines, broken between words or after ``, : = _ -``, but never in a number.

    Continuation lines begin with ``indent``. A word wider than ``width`` stays whole.
    """
    for part in text.split("\n"):
        line = ""
        for word in breaks.split(part):
            if line.strip() and _width(line) + _width(word.rstrip()) > width:
                yield line.rstrip()
                line = indent
            line += word
        yield line.rstrip()


def _width(text: str) -> int:
    """Return the terminal column count of a line: two per East Asian letter, none per accent."""
    if text.isascii():
        return len(text)
    from rich.cells import cell_len

    return cell_len(text)


def _widest(cells: Sequence[str]) -> int:
    return max((_width(line) for cell in cells for line in cell.split("\n")), default=0)


def _longest_word(cells: Sequence[str]) -> int:
    words = (word.rstrip() for cell in cells for part in cell.split("\n") for word in _BREAKS.split(part))
    return max(map(_width, words), default=0)
