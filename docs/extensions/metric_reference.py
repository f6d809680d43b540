"""The directive ``metric-classes``: every metric that is installed, as its class describes it."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

from agglo_core.registry import default
from agglo_core.registry.construct import resolve


class MetricClasses(SphinxDirective):
    """A table of the metrics."""

    def run(self) -> list[nodes.Node]:
        """Parse the table."""
        box = nodes.container()
        self.state.nested_parse(StringList(list(table()), source="metrics"), self.content_offset, box)
        return box.children


def table() -> Iterator[str]:
    """Lines of Markdown, one for each metric."""
    yield from ("| metric | what it is | better | range |", "|---|---|---|---|")
    for record in (each for each in default().list() if each.kind == "metric"):
        found: Any = resolve(record)
        headline = (inspect.getdoc(found) or "").partition("\n\n")[0].replace("\n", " ").replace("|", "\\|")
        low, high = (f"{bound:g}".replace("inf", "∞") for bound in found.bounds)
        yield f"| `{record.name}` | {headline} | {found.better} | {low} to {high} |"


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("metric-classes", MetricClasses)
    return {"parallel_read_safe": True}
