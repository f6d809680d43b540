"""``agglo plugins``: every component and command, its state and why."""

from __future__ import annotations

from typing import Any

import click

from agglo_core.cli.console import print_json, print_table
from agglo_core.registry import Record, default

__all__ = ["plugins"]


@click.command(short_help="List plugins, their components and states.")
@click.option("-v", "--verbose", is_flag=True, help="Also show what each is, promises and requires.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of records.")
def plugins(verbose: bool, as_json: bool) -> None:
    """List the components and commands of all plugins, with their states.

    States: ok; needs (a package that is not installed); broken; conflict (the name is taken); blocked
    (by AGGLO_BLOCK or AGGLO_ONLY). Installing a plugin runs its code: its declaration is imported by
    every command. AGGLO_TRACE=1 shows how.
    """
    registry = default()
    records = [*registry.list(), *registry.commands()]
    if as_json:
        print_json([_data(record) for record in records])
        return
    columns = ["kind", "name", "plugin", "distribution", "state", "about"]
    print_table("", columns, [_row(record, verbose) for record in records], fold="about")


def _row(record: Record, verbose: bool) -> list[str]:
    origin = f"{record.distribution} {record.version}".strip() or "–"
    about = [record.reason] if record.state != "ok" else []
    if verbose:
        data = _data(record)
        about += [data["summary"], f"target {data['target']}" if data["target"] else ""]
        about += [f"requires {', '.join(data['requires'])}" if data["requires"] else ""]
        promises = (
            f"{name}={value}" if value is not True else name for name, value in data["promises"].items()
        )
        about += [f"promises {', '.join(promises)}" if data["promises"] else ""]
    elif record.state == "ok":
        about = [_data(record)["summary"]]
    text = "\n".join(line for line in about if line)
    return [str(record.kind), str(record.name), record.plugin, origin, record.state, text]


def _data(record: Record) -> dict[str, Any]:
    """Plain data of a record; a broken declaration may hold anything, so its values become text."""
    component, declared = record.component, record.component or record.command
    whole = component is not None and record.state != "broken"
    return {
        "kind": str(record.kind),
        "name": str(record.name),
        "plugin": record.plugin,
        "distribution": record.distribution,
        "version": record.version,
        "state": record.state,
        "reason": record.reason,
        "missing": list(record.missing),
        "target": str(declared.target) if declared else "",
        "summary": str(declared.summary) if declared else "",
        "requires": list(component.requires) if component and whole else [],
        "promises": dict(component.promises) if component and whole else {},
    }
