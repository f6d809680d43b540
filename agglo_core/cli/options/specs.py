"""Parse single arguments: a mesh, a component with its options, a list of either."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from agglo_core.errors import FileError, OptionError, PluginError
from agglo_core.registry import default
from agglo_core.registry.construct import checked_options, resolve
from agglo_core.registry.option_types import Text, parse_value

if TYPE_CHECKING:
    from agglo_core.mesh import Mesh

Value = int | float | bool | str | None
"""What :func:`parse_spec` gives for an option."""

_SAMPLE = re.compile(r"([\w.-]+/)?[A-Za-z_]\w*(:(\w+=.*|[^/\\]*))?")


def load_mesh(text: str | Path) -> Mesh:
    """Read the mesh file ``text``, or make the sample it describes.

    Raises
    ------
    FileError
        If it is a file that cannot be read, or neither a file nor the form of a sample.
    OptionError
        If it has the form of a sample, but is none.

    Examples
    --------
    >>> from agglo_core.authoring import load_mesh
    >>> load_mesh("squares:n=4")
    Mesh('squares 4x4', 2-D, 16 cells, 40 faces, 25 points)
    """
    text = str(text)
    if not text:
        raise FileError("the name of the mesh is empty; expected a file or a sample such as squares:n=64")
    if Path(text).exists():
        from agglo_core.io import read

        return read(Path(text))
    if not _SAMPLE.fullmatch(text):
        raise FileError(
            f"{text!r} is neither a file (there is none of that name) nor a sample such as squares:n=64"
        )
    from agglo_core import samples

    try:
        return samples.from_spec(text)
    except OptionError as error:
        if not isinstance(error.__cause__, PluginError):  # it is a sample, and one of its options is wrong
            raise
        raise OptionError(
            f"{text!r} is neither a file (there is none of that name) nor a sample: {error}"
        ) from error


def parse_spec(text: str) -> tuple[str, dict[str, Value]]:
    """Split ``"metis:ufactor=30,contig=true"`` into its name and options, each the value it reads as.

    For what is no component; the options of a component are converted by their own types: :func:`choice`.

    Raises
    ------
    OptionError
        If the name is missing, or an option is not of the form ``option=value`` or is given twice.

    Examples
    --------
    >>> from agglo_core.authoring import parse_spec
    >>> parse_spec("metis:ufactor=30,contig=true")
    ('metis', {'ufactor': 30, 'contig': True})
    """
    name, options = as_typed(text)
    return name, {option: parse_value(value) for option, value in options.items()}


def as_typed(text: str) -> tuple[str, dict[str, Text]]:
    """Name and options of a component, each as it was typed: the registry knows what it is to become.

    Raises
    ------
    OptionError
        If the name is missing, or an option is not of the form ``option=value`` or is given twice.
    """
    name, _, rest = text.partition(":")
    if not name.strip():
        raise OptionError(f"{text!r} has no name; expected NAME or NAME:option=value,…")
    options: dict[str, Text] = {}
    for item in rest.split(",") if rest else ():
        option, equals, value = (part.strip() for part in item.partition("="))
        if not equals or not option.isidentifier() or not value:
            raise OptionError(f"{item!r} in {text!r} is not of the form option=value")
        if option in options:
            raise OptionError(f"{text!r} gives {option!r} twice")
        options[option] = Text(value)
    return name.strip(), options


def split_specs(text: str) -> list[str]:
    """Split ``"kmeans,metis:ufactor=30,contig=true,spectral"`` into its three components.

    An item ``option=value`` belongs to the component before it.
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
    """Names of the bisectors that can be used here."""
    return [record.name for record in default().list() if record.kind == "bisector" and record.state == "ok"]


def bisector_specs(typed: Sequence[str]) -> list[str]:
    """The bisectors of a repeatable option whose values may be comma lists; ``all`` is all that can be used.

    Raises
    ------
    UsageError
        If one is given twice.
    """
    specs = [spec for text in typed for spec in split_specs(text)]
    refuse_duplicates("--bisector", specs)
    expanded = [name for spec in specs for name in (all_bisectors() if spec == "all" else [spec])]
    return list(dict.fromkeys(expanded))


def choice(kind: str, spec: str) -> tuple[str, dict[str, Any]]:
    """Name and options of a component that can be used, each option as its type wants it.

    Raises
    ------
    PluginError
        If there is no such component, or it cannot be used.
    OptionError
        For an option that it does not have, or a value that does not fit.

    Examples
    --------
    >>> from agglo_core.authoring import choice
    >>> choice("bisector", "sweep:axes=4")
    ('sweep', {'axes': 4})
    """
    name, options = as_typed(spec)
    record = default().record(kind, name)
    return name, checked_options(record, resolve(record), options)


def refuse_duplicates(flag: str, specs: Sequence[str]) -> None:
    """Raise UsageError if something is given twice."""
    twice = sorted({spec for spec in specs if specs.count(spec) > 1})
    if twice:
        raise click.UsageError(f"{flag} {', '.join(twice)} is given twice")
