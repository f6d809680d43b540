"""The directive ``notebook NAME``: a notebook of ``docs/notebooks``, run, with its words, code and outputs.

It is run where the site is built, so it shows what this version does; the file itself has no outputs.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
RUN = NOTEBOOKS / "run"


class Notebook(SphinxDirective):
    """A section for a notebook, titled by the heading of its first cell."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Parse its cells one after the other."""
        import nbformat

        path = NOTEBOOKS / f"{self.arguments[0]}.ipynb"
        self.env.note_dependency(str(path))
        cells = nbformat.read(RUN / path.name, as_version=4).cells
        heading, _, cells[0].source = cells[0].source.partition("\n")
        title = heading.lstrip("# ")
        section = nodes.section(ids=[nodes.make_id(title)], names=[nodes.fully_normalize_name(title)])
        section += nodes.title(text=title)
        for cell in cells:
            if cell.cell_type == "markdown":
                self.state.nested_parse(StringList(cell.source.splitlines(), source=str(path)), 0, section)
            else:
                section += nodes.literal_block(cell.source, cell.source, language="python")
                section += [shown(output) for output in cell.outputs]
        self.state.document.note_implicit_target(section, section)
        return [section]


def shown(output: Any) -> nodes.Node:
    """The richest form of an output that a page can show."""
    data = output.get("data", {})
    if "text/html" in data:
        return nodes.raw("", f'<div class="output">{data["text/html"]}</div>', format="html")
    if "image/png" in data:
        source = "".join(data["image/png"].split())
        return nodes.raw("", f'<img alt="output" src="data:image/png;base64,{source}">', format="html")
    text = output.get("text") or data.get("text/plain", "")
    return nodes.literal_block(text, text, language="output")


def execute(app: Any) -> None:
    """Run the notebooks that are newer than what they have shown.

    Raises
    ------
    ExtensionError
        If one fails, with what it said.
    """
    import nbformat
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError

    RUN.mkdir(exist_ok=True)
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        done = RUN / path.name
        if done.is_file() and done.stat().st_mtime >= path.stat().st_mtime:
            continue
        notebook = nbformat.read(path, as_version=4)
        with tempfile.TemporaryDirectory() as folder:
            client = NotebookClient(notebook, timeout=600, resources={"metadata": {"path": folder}})
            try:
                client.execute(env=os.environ | {"IPYTHONDIR": folder})
            except CellExecutionError as error:
                raise ExtensionError(f"{path.name}: {error}") from error
        nbformat.write(notebook, done)


def setup(app: Any) -> dict[str, bool]:
    """Register the directive, and run the notebooks before pages are read."""
    app.add_directive("notebook", Notebook)
    app.connect("builder-inited", execute)
    return {"parallel_read_safe": True}
