"""``agglo formats``: list the file formats with their suffixes."""

from __future__ import annotations

import textwrap

import click

from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.output.tables import print_table
from agglo_core.registry import default

_COLUMNS = ("suffixes", "access", "format", "holds")
_WIDTH = 40  # characters of suffixes in a line


@click.command(cls=OwnCommand, short_help="List the file formats and their suffixes.")
def formats() -> None:
    """List the file formats, those of plugins included, in the order in which they are tried.

    The suffix of a file selects the format. Formats that cannot be used are listed with the reason.
    """
    from agglo_core.io.formats import Formats, KnownFormat, declared_suffixes

    rows = []
    known = Formats(default())
    for record in known.records():
        built = known.usable(record)
        if isinstance(built, KnownFormat):
            suffixes = built.suffixes
            access = ", ".join(method for method in ("read", "write") if built.has(method))
            holds = record.component.summary if record.component else ""
        else:
            suffixes, access, holds = declared_suffixes(record), "unusable", str(built)
        rows.append([textwrap.fill(" ".join(suffixes) or "–", _WIDTH), access, record.name, holds])
    print_table("", _COLUMNS, rows, fold={"suffixes": 12, "format": 8, "holds": 24}, boxed=False)
