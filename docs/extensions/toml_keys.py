"""The directive ``toml-keys``: keys of a run's file, their defaults and meaning, as ``Pipeline`` has them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from numpydoc.docscrape import ClassDoc
from sphinx.util.docutils import SphinxDirective

from agglo_core import Pipeline
from agglo_core.agglomeration.rules import Rules


class TomlKeys(SphinxDirective):
    """A table of the keys."""

    def run(self) -> list[nodes.Node]:
        """Parse the table."""
        box = nodes.container()
        self.state.nested_parse(StringList(list(table()), source="Pipeline"), self.content_offset, box)
        return box.children


def table() -> Iterator[str]:
    """Lines of Markdown, one for each key."""
    yield from ("| key | value | default | meaning |", "|---|---|---|---|")
    known = described(Pipeline) | described(Rules)
    for field in sorted(fields(Pipeline), key=lambda each: bool(each.kw_only)):
        value, meaning = known[field.name]
        value = value.removesuffix(", optional").replace("|", "\\|")
        yield f"| `{field.name}` | {value} | {written(field.default)} | {meaning} |"


def described(owner: type) -> dict[str, tuple[str, str]]:
    """Type and meaning of each attribute that a class describes; several may share a line."""
    found: dict[str, tuple[str, str]] = {}
    for each in ClassDoc(owner)["Attributes"]:
        for name in each.name.split(", "):
            found[name] = (each.type, " ".join(each.desc).replace("``", "`"))
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
