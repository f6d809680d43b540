"""The directive ``gallery``: every script of ``docs/gallery``, run, with its words, its picture and its code.

A script is run where the site is built, so that the pictures are those of this version; as the main program
each draws ``NAME.png`` into the current folder.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

SCRIPTS = Path(__file__).parents[1] / "gallery"
PICTURES = SCRIPTS / "pictures"


class Gallery(SphinxDirective):
    """A section for each script, in the order in which they are named."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Parse the sections."""
        found: list[nodes.Node] = []
        for name in self.content:
            script = SCRIPTS / f"{name}.py"
            self.env.note_dependency(str(script))
            found += self._section(script, *words(script))
        return found

    def _section(self, script: Path, title: str, text: str) -> list[nodes.Node]:
        section = nodes.section(ids=[nodes.make_id(title)], names=[nodes.fully_normalize_name(title)])
        section += nodes.title(text=title)
        picture = f"![{title}](pictures/{script.stem}.png)"
        lines = [*text.splitlines(), "", picture, "", f"```{{literalinclude}} {script.name}", *OPTIONS, "```"]
        self.state.nested_parse(StringList(lines, source=str(script)), 0, section)
        self.state.document.note_implicit_target(section, section)
        return [section]


OPTIONS = (":language: python", ":start-at: import ")


def words(script: Path) -> tuple[str, str]:
    """First line and rest of a script's docstring."""
    title, _, text = (ast.get_docstring(ast.parse(script.read_text(encoding="utf-8"))) or "").partition("\n")
    return title, text.strip()


def draw(app: Any) -> None:
    """Run the scripts that are newer than their pictures.

    Raises
    ------
    ExtensionError
        If a script fails or leaves no picture; with what it printed.
    """
    PICTURES.mkdir(exist_ok=True)
    for script in sorted(SCRIPTS.glob("*.py")):
        picture = PICTURES / f"{script.stem}.png"
        if picture.is_file() and picture.stat().st_mtime >= script.stat().st_mtime:
            continue
        done = subprocess.run(
            [sys.executable, str(script)], cwd=PICTURES, env=os.environ | {"MPLBACKEND": "Agg"},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode or not picture.is_file():
            raise ExtensionError(f"{script.name} made no picture: {done.stderr or done.stdout}")


def setup(app: Any) -> dict[str, bool]:
    """Register the directive, and draw before pages are read."""
    app.add_directive("gallery", Gallery)
    app.connect("builder-inited", draw)
    return {"parallel_read_safe": True}
