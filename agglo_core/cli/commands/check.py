"""``agglo check``: check a component against the laws of its kind and its promises."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from agglo_core.cli.options.completion import any_names
from agglo_core.cli.options.specs import as_typed
from agglo_core.cli.output.console import print_json
from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.output.tables import print_lines, print_table
from agglo_core.errors import OptionError, PluginError
from agglo_core.registry import KINDS

if TYPE_CHECKING:
    from agglo_core.conformance import Result

_ABOUT = "statement, or fault"


@click.command(cls=OwnCommand, short_help="Check a component against the laws of its kind.")
@click.argument("component", shell_complete=any_names)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of results.")
@click.option("--timeout", default=120.0, show_default=True, help="Time limit of a law, in seconds.")
@click.option(
    "--thorough", is_flag=True, help="Also try large meshes, and measure how the time grows with size."
)
def check(component: str, as_json: bool, timeout: float, thorough: bool) -> int:
    """Check COMPONENT (mine, bisector:mine, metric:mine:option=value), and print a remedy for each failure.

    Exit codes: 0 all laws hold, 2 unknown component, 3 a law fails.
    """
    before, _, after = component.partition(":")
    kind, spec = (before, after) if before in KINDS else (None, component)
    name, options = as_typed(spec)
    if not timeout > 0:
        raise OptionError(f"--timeout must be positive, given {timeout:g}")
    from agglo_core import conformance

    results = conformance.check(name, kind, timeout, options=options, thorough=thorough)
    if not results:
        raise PluginError(f"no law was judged for {component!r}")
    if as_json:
        print_json([asdict(result) for result in results])
    else:
        _show(component, results)
    return 0 if all(result.passed for result in results) else 3


def _show(component: str, results: list[Result]) -> None:
    rows = [
        [
            result.law if result.promise is None else f"{result.law} ({result.promise})",
            "ok" if result.passed else "FAILS",
            f"{result.seconds:.2f}",
            result.sentence if result.passed else result.message,
        ]
        for result in results
    ]
    columns = ["law", "state", "seconds", _ABOUT]
    print_table("", columns, rows, spare=["seconds"], fold={"law": 16, _ABOUT: 30})
    n_failures = sum(not result.passed for result in results)
    print_lines(f"{component}: {len(results) - n_failures} of {len(results)} laws hold")
