"""Parsing of texts that describe a mesh, a component with options, or a list of components."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.errors import FileError, OptionError, PluginError
from agglo_core.registry import default
from agglo_core.registry.construct import check_options, resolve
from agglo_core.registry.option_types import Text, parse_value

if TYPE_CHECKING:
    from agglo_core.mesh import Mesh

Value = int | float | bool | str | None
"""Option value as returned by :func:`parse_spec`."""

_SAMPLE = re.compile(r"([\w.-]+/)?[A-Za-z_]\w*(:(\w+=.*|[^/\\]*))?")


def load_mesh(text: str | Path) -> Mesh:
    """Read the mesh file ``text``, or build the sample described by ``text``.

    Raises
    ------
    FileError
        For an unreadable file, or a text that is neither a file nor has the form of a sample.
    OptionError
        For a text with the form of a sample, but without such a sample.

    Examples
    --------
    >>> from agglo_core.authoring import load_mesh
    >>> load_mesh("squares:n=4")
    Mesh('squares 4x4', 2-D, 16 cells, 40 faces, 25 points)
    """
    text = str(text)
    if not text:
        raise FileError("the mesh name is empty; expected a file or a sample such as squares:n=64")
    if Path(text).exists():
        from agglo_core.io import read

        return read(Path(text))
    if not _SAMPLE.fullmatch(text):
        raise FileError(f"{text!r} is neither an existing file nor a sample such as squares:n=64")
    from agglo_core import samples

    try:
        return samples.from_spec(text)
    except OptionError as error:
        if not isinstance(error.__cause__, PluginError):  # a known sample with an invalid option
            raise
        raise OptionError(f"{text!r} is neither an existing file nor a sample: {error}") from error


def parse_spec(text: str) -> tuple[str, dict[str, Value]]:
    """Split ``"metis:ufactor=30,contig=true"`` into name and options, and infer the value types.

    Not for components: :func:`choice` converts component options by their declared types.

    Raises
    ------
    OptionError
        If the name is missing, or an option is not of the form ``option=value`` or given twice.

    Examples
    --------
    >>> from agglo_core.cli.options.specs import parse_spec
    >>> parse_spec("metis:ufactor=30,contig=true")
    ('metis', {'ufactor': 30, 'contig': True})
    """
    name, options = as_typed(text)
    return name, {option: parse_value(value) for option, value in options.items()}


def as_typed(text: str) -> tuple[str, dict[str, Text]]:
    """Split ``"metis:ufactor=30"`` into name and options, with all values as text.

    Raises
    ------
    OptionError
        If the name is missing, or an option is not of the form ``option=value`` or given twice.
    """
    name, _, option_text = text.partition(":")
    if not name.strip():
        raise OptionError(f"{text!r} has no name; expected NAME or NAME:option=value,…")
    options: dict[str, Text] = {}
    for item in option_text.split(",") if option_text else ():
        option, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not option.isidentifier() or not value:
            raise OptionError(f"{item!r} in {text!r} is not of the form option=value")
        if option in options:
            raise OptionError(f"{text!r} sets option {option!r} twice")
        options[option] = Text(value)
    return name.strip(), options


def split_specs(text: str) -> list[str]:
    """Split ``"kmeans,metis:ufactor=30,contig=true,spectral"`` into its three components.

    An item ``option=value`` belongs to the preceding component.
    """
    specs: list[str] = []
    for item in text.split(","):
        continues = "=" in item.partition(":")[0]
        if continues and specs:
            specs[-1] += f",{item}"
        else:
            specs.append(item.strip())
    return specs


def all_bisectors() -> list[str]:
    """Return all usable bisector names."""
    return [record.name for record in default().list() if record.kind == "bisector" and record.state == "ok"]


def bisector_specs(typed: Sequence[str]) -> list[str]:
    """Split comma-separated bisector lists, where ``all`` stands for all usable bisectors.

    Raises
    ------
    UsageError
        If a bisector is given twice.
    """
    specs = [spec for text in typed for spec in split_specs(text)]
    refuse_duplicates("--bisector", specs)
    expanded = [name for spec in specs for name in (all_bisectors() if spec == "all" else [spec])]
    return list(dict.fromkeys(expanded))


def choice(kind: str, spec: str) -> tuple[str, dict[str, Any]]:
    """Split ``"metis:ufactor=30"`` into name and options, with values of the types that ``metis`` declares.

    Raises
    ------
    PluginError
        For an unknown or unusable component.
    OptionError
        For an unknown option or an invalid value.

    Examples
    --------
    >>> from agglo_core.authoring import choice
    >>> choice("bisector", "sweep:axes=4")
    ('sweep', {'axes': 4})
    """
    name, options = as_typed(spec)
    record = default().record(kind, name)
    return name, check_options(record, resolve(record), options)


def refuse_duplicates(flag: str, specs: Sequence[str]) -> None:
    """Raise UsageError if an option lists the same value twice."""
    duplicates = sorted({spec for spec in specs if specs.count(spec) > 1})
    if duplicates:
        raise click.UsageError(f"{flag} {', '.join(duplicates)} is given twice")
