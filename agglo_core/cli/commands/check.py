"""``agglo check``: check a component against the laws of its kind and its promises."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from agglo_core.cli.options.completion import any_names
from agglo_core.cli.options.specs import as_typed
from agglo_core.cli.output.console import print_json
from agglo_core.cli.output.encoding import replace_unencodable
from agglo_core.cli.output.stdout import OwnCommand, stdout
from agglo_core.cli.output.tables import print_lines, print_table
from agglo_core.errors import OptionError, PluginError
from agglo_core.registry import KINDS

if TYPE_CHECKING:
    from agglo_core.conformance import Result

_ABOUT = "statement, or fault"
_OTHERS = {"FAILS": "fail", "not run": "not run", "suite error": "met an error of the suite"}


@click.command(cls=OwnCommand, short_help="Check a component against the laws of its kind.")
@click.argument("component", shell_complete=any_names)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of results.")
@click.option("--timeout", default=120.0, show_default=True, help="Time limit of a law, in CPU seconds.")
@click.option("--law", "laws", multiple=True, help="Judge only this law (can be repeated).")
@click.option(
    "--thorough", is_flag=True, help="Also try large meshes, and measure how the time grows with size."
)
def check(component: str, as_json: bool, timeout: float, laws: Sequence[str], thorough: bool) -> int:
    """Check COMPONENT (mine, bisector:mine, metric:mine:option=value), and print a remedy for each failure.

    Exit codes: 0 all laws hold, 2 unknown component or law, 3 a law fails, 4 no law fails but some were not
    run or met an error of the suite.
    """
    before, _, after = component.partition(":")
    kind, spec = (before, after) if before in KINDS else (None, component)
    name, options = as_typed(spec)
    if not timeout > 0:
        raise OptionError(f"--timeout must be positive, given {timeout:g}")
    from agglo_core import conformance

    results = conformance.check(name, kind, timeout, options=options, thorough=thorough, laws=laws)
    if not results:
        raise PluginError(f"no law was judged for {component!r}")
    if as_json:
        print_json([asdict(result) | {"passed": result.passed} for result in results])
    else:
        _show(component, results)
    states = {result.state for result in results}
    return 0 if states == {"ok"} else 3 if "FAILS" in states else 4


def _show(component: str, results: list[Result]) -> None:
    # Failures of one cause share a row; failures come first, then laws without a verdict.
    order = ("FAILS", "suite error", "not run", "ok")
    first: dict[str, Result] = {}
    also: dict[str, list[str]] = {}
    for result in results:
        leader = first.setdefault(
            result.cause if result.state == "FAILS" and result.cause else result.law, result
        )
        also.setdefault(leader.law, []).append(result.law)
    rows = [
        [
            result.law if result.promise is None else f"{result.law} ({result.promise})",
            result.state,
            f"{result.seconds:.2f}",
            (result.sentence if result.passed else result.message) + _also(also[result.law][1:]),
        ]
        for result in sorted(first.values(), key=lambda result: order.index(result.state))
    ]
    columns = ["law", "state", "seconds", _ABOUT]
    print_table("", columns, rows, spare=["seconds"], fold={"law": 16, _ABOUT: 30})
    counts = {state: sum(result.state == state for result in results) for state in order}
    others = [f"{counts[state]} {text}" for state, text in _OTHERS.items() if counts[state]]
    verdict = ", ".join([f"{counts['ok']} of {len(results)} laws hold", *others])
    for result in first.values():
        if result.code:  # not wrapped, so that it can be copied
            click.echo(replace_unencodable(f"# {result.law} fails on\n{result.code}\n"), file=stdout())
    print_lines(f"{component}: {verdict}")


def _also(laws: list[str]) -> str:
    """Return a sentence that names the other laws with the same fault, or an empty string."""
    return f". The same fault breaks {len(laws)} more laws: {', '.join(laws)}" if laws else ""
