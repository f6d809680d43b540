"""The directive ``component-table``: the installed components of a kind, each with its summary."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

from agglo_core.registry import default


class ComponentTable(SphinxDirective):
    """A table of the components of the kind that is given as the argument."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Parse the table."""
        box = nodes.container()
        lines = StringList(list(table(self.arguments[0])), source=self.arguments[0])
        self.state.nested_parse(lines, self.content_offset, box)
        return box.children


def table(kind: str) -> Iterator[str]:
    """Yield the lines of a Markdown table, a row per component."""
    yield from ("| name | summary |", "|---|---|")
    for record in default().list():
        if record.kind == kind and record.component is not None:
            summary = record.component.summary.replace("|", "\\|")
            yield f"| `{record.name}` | {summary} |"


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("component-table", ComponentTable)
    return {"parallel_read_safe": True}
