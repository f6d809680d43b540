"""The command ``agglo model``, which inspects files with trained networks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from agglo_core.authoring import print_lines
from agglo_core.cli.options.agglomeration import FILE


@click.group()
def model() -> None:
    """Inspect model files."""


@model.command()
@click.argument("file", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print the header as JSON.")
def info(file: Path, as_json: bool) -> None:
    """Check FILE and show its architecture, features, training, seed, version and metrics."""
    from agglo_gnn.model_file import load

    arrays, header = load(file)
    if as_json:
        click.echo(json.dumps(header, indent=2, sort_keys=True))
        return
    parameters = sum(array.size for array in arrays.values())
    print_lines(f"{file}: {len(arrays)} arrays, {parameters:,} numbers")
    order = ["architecture", "features", "recipe", "seed", "version", "metrics"]
    rest = sorted(header.keys() - {*order, "arrays"})
    for key in [*order, *rest]:
        print_lines(f"  {key:<13}{_in_words(header[key])}")


def _in_words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_in_words(each)}" for key, each in value.items())
    if isinstance(value, list):
        return ", ".join(map(_in_words, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
