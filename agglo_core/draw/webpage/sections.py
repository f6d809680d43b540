"""The sections of the page: its own, a file of HTML each, and those of plugins after them."""

from __future__ import annotations

import html
import logging
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Final

from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh
from agglo_core.registry import Registry, describe
from agglo_core.registry.containment import PLUGIN_FAILURES, raised

OWN: Final = ("map", "charts", "runs", "parts", "words")
"""Names of the page's own sections, in their order: ``templates/section_<name>.html``."""


def own_sections() -> str:
    """The page's own sections, which its scripts fill."""
    here = files(__package__) / "templates"
    return "".join((here / f"section_{name}.html").read_text(encoding="utf-8") for name in OWN)


def sections_of_plugins(mesh: Mesh, runs: Sequence[RunResult], registry: Registry) -> str:
    """Every component of kind ``section`` that can be used, each in a ``<section>`` of its own.

    Titles are escaped, fragments stay as they are; where a fragment is empty there is no section. One that
    fails becomes a note in its place and a warning in the log, which name the plugin.
    """
    return "\n".join(_theirs(mesh, runs, registry))


def _theirs(mesh: Mesh, runs: Sequence[RunResult], registry: Registry) -> Iterator[str]:
    for record in registry.list():
        if record.kind != "section" or record.state != "ok":
            continue
        try:
            section = registry.assemble(record, {})
            title, fragment = section.title, section.html(mesh, tuple(runs))
            if not isinstance(fragment, str):
                raise TypeError(f"html returned {type(fragment).__name__}, expected a string")
            f"{title}{fragment}".encode()  # what cannot be written must not take the report with it
        except PLUGIN_FAILURES as error:
            why = f"{describe(record)} is left out of the report: {raised(error)}"
            logging.getLogger("agglo").warning("%s", why)
            title, fragment = record.name, f'<p class="hint">{html.escape(why)}</p>'
        if not fragment.strip():
            continue
        yield f'<section class="theirs">\n<h2>{html.escape(title)}</h2>\n{fragment}\n</section>'
