"""``agglo plugins``: list all components and commands with state, or a component's options."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import click

from agglo_core.cli.options.completion import any_names
from agglo_core.cli.output.console import print_json
from agglo_core.cli.output.stdout import OwnCommand
from agglo_core.cli.output.tables import print_lines, print_table
from agglo_core.errors import PluginError
from agglo_core.registry import KINDS, Record, Registry, default, describe
from agglo_core.registry.construct import resolve
from agglo_core.registry.options import Option, options_of

_COLUMNS = ("kind", "name", "plugin", "distribution", "state", "about")
_SLOW = 2.0  # seconds: imports of plugins delay every command


@click.command(cls=OwnCommand, short_help="List plugins, their components, states and options.")
@click.argument("name", required=False, shell_complete=any_names)
@click.option("-v", "--verbose", is_flag=True, help="Also show promises, requirements and slow imports.")
@click.option("--json", "as_json", is_flag=True, help="Print a JSON list of records.")
def plugins(name: str | None, verbose: bool, as_json: bool) -> None:
    """List the components and commands of all plugins, with their states.

    With NAME (metis, bisector:metis, plugin/metis), describe this component and its options with type,
    default and meaning.

    States: ok; needs (a package is not installed); broken; conflict (the name is taken); blocked
    (by AGGLO_BLOCK or AGGLO_ONLY). Installing a plugin runs its code: every command imports its
    declaration. AGGLO_TRACE=1 shows each call.
    """
    registry = default()
    records = registry.records() if name is None else _find_records(registry, name)
    if as_json:
        print_json([_data(record) | (_options_data(record) if name else {}) for record in records])
    elif name is None:
        rows = [_row(record, verbose) for record in records]
        fold = {"name": 10, "about": 24}
        print_table("", _COLUMNS, rows, spare=["distribution", "plugin"], fold=fold, boxed=False)
    else:
        for record in records:
            print_lines("\n".join(_card(record)))


def _find_records(registry: Registry, text: str) -> list[Record]:
    """Return the records of components with a given name, several if kinds share the name.

    Accepted forms are ``name``, ``kind:name`` and ``plugin/name``.

    Raises
    ------
    PluginError
        If there is no such record.
    """
    kind, colon, name = text.partition(":")
    if colon:
        return [registry.record(kind, name)]
    matches = [r for r in registry.records() if text in (r.name, f"{r.plugin}/{r.name}", r.plugin)]
    exact = [record for record in matches if record.name == text]
    if matches:
        return exact or matches
    names = ", ".join(sorted({str(record.name) for record in registry.records()}))
    failures = "; ".join(f"{describe(r)}: {r.reason}" for r in registry.records() if r.kind == "plugin")
    raise PluginError(
        f"no component, command or plugin is named {text!r}; available: {names}"
        + (f"; plugins that cannot be used: {failures}" if failures else "")
    )


def _row(record: Record, verbose: bool) -> list[str]:
    origin = f"{record.distribution} {record.version}".strip() or "–"
    about = [record.reason] if record.state != "ok" else []
    if verbose:
        about += _particulars(record)
        if record.import_seconds > _SLOW:
            about.append(f"slow: importing plugin {record.plugin!r} took {record.import_seconds:.1f} s")
    elif record.state == "ok":
        about = [_data(record)["summary"]]
    text = "\n".join(line for line in about if line)
    return [str(record.kind), str(record.name), record.plugin, origin, record.state, text]


def _particulars(record: Record) -> list[str]:
    data = _data(record)
    promises = (f"{name}={value}" if value is not True else name for name, value in data["promises"].items())
    return [
        data["summary"],
        f"target {data['target']}" if data["target"] else "",
        f"requires {', '.join(data['requires'])}" if data["requires"] else "",
        f"promises {', '.join(promises)}" if data["promises"] else "",
    ]


def _card(record: Record) -> Iterator[str]:
    """Yield the lines of text that describe a component and its options."""
    kind = KINDS.get(record.kind)
    yield f"{describe(record)}: {record.state}"
    if record.reason:
        yield f"  {record.reason}"
    if kind:
        yield f"  {kind.name}: {kind.summary}"
    yield from (f"  {line}" for line in _particulars(record) if line)
    if record.state != "ok" or record.component is None:
        return
    options = options_of(resolve(record))
    if options is None:
        yield "  options: any; checked by the component"
    elif not options:
        yield "  no options"
    else:
        yield "  options:"
        yield from (f"    {line}" for option in options for line in _lines(option))


def _lines(option: Option) -> list[str]:
    default_text = "required" if option.required else f"default {option.default!r}"
    head = f"{option.name}: {option.type_name}; {default_text}"
    return [head, f"    {option.about}"] if option.about else [head]


def _options_data(record: Record) -> dict[str, Any]:
    """Return the options of a component in JSON types, or None if the component cannot be imported."""
    if record.state != "ok" or record.component is None:
        return {"options": None}
    options = options_of(resolve(record))
    if options is None:
        return {"options": None}
    return {
        "options": [
            {
                "name": option.name,
                "type": option.type_name,
                "required": option.required,
                "default": None if option.required else repr(option.default),
                "about": option.about,
            }
            for option in options
        ]
    }


def _data(record: Record) -> dict[str, Any]:
    """Return the record of a component in JSON types.

    Values become text, because a broken declaration may contain anything.
    """
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
        "import_seconds": round(record.import_seconds, 3),
        "target": str(declared.target) if declared else "",
        "summary": str(declared.summary) if declared else "",
        "requires": list(component.requires) if component and whole else [],
        "promises": dict(component.promises) if component and whole else {},
    }
