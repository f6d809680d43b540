"""Groups of options in help texts."""

from __future__ import annotations

from itertools import chain

import click

from agglo_core.agglomeration.keywords import GROUPS

_OF_COMMANDS = {
    "Method": ("bisectors", "methods"),
    "Running": ("independent",),
    "Solver": (
        "solver",
        "levels",
        "degree",
        "discretisation",
        "smoothing_steps",
        "tolerance",
        "problem",
        "cg",
    ),
}
"""Parameters of commands in addition to the keywords of ``agglomerate``, by group."""
_TITLES = {name: title for title, names in chain(GROUPS.items(), _OF_COMMANDS.items()) for name in names}


def write_options(context: click.Context, formatter: click.HelpFormatter) -> None:
    """Write the options of a command: in groups if there are targets, else in one list."""
    options = [each for each in context.command.get_params(context) if isinstance(each, click.Option)]
    grouped = any(option.name in GROUPS["Targets"] for option in options)
    titles, rest = (_TITLES, "Output and help") if grouped else ({}, "Options")
    sections: dict[str, list[tuple[str, str]]] = {title: [] for title in (*titles.values(), rest)}
    for option in options:
        row = option.get_help_record(context)
        if row is not None:  # not a hidden option
            sections[titles.get(option.name or "", rest)].append(row)
    for title, rows in sections.items():
        if rows:
            with formatter.section(title):
                formatter.write_dl(rows)
