"""Sections of the report: built-in ones from HTML files, then those of plugins."""

from __future__ import annotations

import html
import logging
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Final

from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh
from agglo_core.registry import Registry, describe
from agglo_core.registry.containment import PLUGIN_FAILURES, describe_error

OWN: Final = ("map", "charts", "runs", "parts", "words")
"""Names of the built-in sections, in order: ``templates/section_<name>.html``."""


def own_sections() -> str:
    """Return the built-in sections as HTML, to be filled with data by scripts."""
    here = files(__package__) / "templates"
    return "".join((here / f"section_{name}.html").read_text(encoding="utf-8") for name in OWN)


def sections_of_plugins(mesh: Mesh, runs: Sequence[RunResult], registry: Registry) -> str:
    """Return the report sections that plugins contribute, as HTML.

    Titles are escaped, fragments are kept unchanged. Empty fragments make no section. A failing section
    becomes a note in its place and a warning in the log, both with the plugin's name.
    """
    return "\n".join(_render_sections(mesh, runs, registry))


def _render_sections(mesh: Mesh, runs: Sequence[RunResult], registry: Registry) -> Iterator[str]:
    for record in registry.list():
        if record.kind != "section" or record.state != "ok":
            continue
        try:
            section = registry.assemble(record, {})
            title, fragment = section.title, section.html(mesh, tuple(runs))
            if not isinstance(fragment, str):
                raise TypeError(f"html returned {type(fragment).__name__}, expected a string")
            f"{title}{fragment}".encode()  # unencodable text must not break the report
        except PLUGIN_FAILURES as error:
            why = f"{describe(record)} is left out of the report: {describe_error(error)}"
            logging.getLogger("agglo").warning("%s", why)
            title, fragment = record.name, f'<p class="hint">{html.escape(why)}</p>'
        if not fragment.strip():
            continue
        yield f'<section class="theirs">\n<h2>{html.escape(title)}</h2>\n{fragment}\n</section>'
