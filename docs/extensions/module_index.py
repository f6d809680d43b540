"""The directive ``module-index``: a table of each folder, with the headline of each of its modules.

Sources are parsed, not imported: the page needs no optional package and shows what is in the checkout.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).parents[2]
PACKAGES = (ROOT / "agglo_core", *sorted((ROOT / "plugins").glob("agglo_*")))


class ModuleIndex(SphinxDirective):
    """A section for each folder that holds modules."""

    def run(self) -> list[nodes.Node]:
        """Parse the tables, one section a folder."""
        return [self._section(folder) for folder in folders()]

    def _section(self, folder: Path) -> nodes.section:
        title = folder.relative_to(ROOT).as_posix()
        section = nodes.section(ids=[nodes.make_id(title)], names=[nodes.fully_normalize_name(title)])
        section += nodes.title(text=title)
        self.state.nested_parse(StringList(list(table(folder)), source=title), 0, section)
        self.state.document.note_implicit_target(section, section)
        for file in modules(folder):
            self.env.note_dependency(str(file))
        return section


def folders() -> Iterator[Path]:
    """Yield each folder of the core and the plugins that holds modules, a folder before those in it."""
    for package in PACKAGES:
        inside = sorted(path for path in package.rglob("*") if path.is_dir())
        yield from (folder for folder in (package, *inside) if any(folder.glob("*.py")))


def modules(folder: Path) -> list[Path]:
    """List the modules of a folder, ``__init__.py`` first."""
    return sorted(folder.glob("*.py"), key=lambda file: (file.stem != "__init__", file.stem))


def headline(file: Path) -> str:
    """Return the first line of a module's docstring.

    Raises
    ------
    ExtensionError
        If there is none; names the file.
    """
    lines = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").splitlines()
    if not lines:
        raise ExtensionError(f"{file}: the module has no docstring, whose first line the index shows")
    return lines[0]


def table(folder: Path) -> Iterator[str]:
    """Lines of reStructuredText: the headline of the folder, and a row for each of its other modules."""
    first, *others = modules(folder)
    if first.stem == "__init__":
        summary, rows = headline(first), others
    else:
        summary, rows = "", [first, *others]
    yield from ("```{eval-rst}", summary, "")
    if rows:
        yield from (".. list-table::", "   :widths: 25 75", "")
    for file in rows:
        yield from (f"   * - ``{file.name}``", f"     - {headline(file)}")
    yield "```"


def setup(app: Any) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("module-index", ModuleIndex)
    return {"parallel_read_safe": True}
