"""The directive ``toml-keys``: keys of a run's file, their defaults and meaning."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from numpydoc.docscrape import FunctionDoc
from sphinx.util.docutils import SphinxDirective

from agglo_core import agglomerate
from agglo_core.agglomeration.keywords import Keywords

DEFAULT = re.compile(r"\s*Default \S+\.$")
"""Last sentence of a description: the table has a column for it."""


class TomlKeys(SphinxDirective):
    """A table of the keys."""

    def run(self) -> list[nodes.Node]:
        """Parse the table."""
        box = nodes.container()
        self.state.nested_parse(StringList(list(table()), source="agglomerate"), self.content_offset, box)
        return box.children


def table() -> Iterator[str]:
    """Lines of Markdown, one for each key."""
    yield from ("| key | value | default | meaning |", "|---|---|---|---|")
    known = described()
    for field in fields(Keywords):
        value, meaning = known[field.name]
        yield f"| `{field.name}` | {value} | {written(field.default)} | {meaning} |"


def described() -> dict[str, tuple[str, str]]:
    """Type and meaning of each argument that ``agglomerate`` describes; several may share a line."""
    found: dict[str, tuple[str, str]] = {}
    for each in FunctionDoc(agglomerate)["Parameters"]:
        meaning = DEFAULT.sub("", " ".join(each.desc)).replace("``", "`")
        for name in each.name.split(", "):
            found[name] = (each.type.removesuffix(", optional").replace("|", "\\|"), meaning)
    return found


def written(value: Any) -> str:
    """A default as TOML writes it."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple):
        return f"`[{', '.join(repr(each) for each in value)}]`".replace("'", '"')
    return f"`{value!r}`".replace("'", '"')


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("toml-keys", TomlKeys)
    return {"parallel_read_safe": True}
