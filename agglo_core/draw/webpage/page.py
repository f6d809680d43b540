"""The HTML file: template, style and scripts with the data of a comparison inside."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from agglo_core.draw.webpage.payload import payload
from agglo_core.draw.webpage.sections import own_sections, sections_of_plugins
from agglo_core.draw.webpage.solve_section import solve_section
from agglo_core.errors import FileError
from agglo_core.io.atomic import check_replaceable, staging
from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh
from agglo_core.registry import Registry, default
from agglo_core.registry.discovery import version_of

_NOTHING: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType({})
_NO_RUNS: Final = MappingProxyType(
    {
        "/*policy*/": "'none'",
        "<!--noscript-->": "",
        "<!--own-->": "",
        "<!--scripts-->": "",
        "<!--theirs-->": "",
    }
)
"""The page without the parts that show runs."""
_SHARED: Final = (
    "sight.js",
    "panel.js",
    "charts.js",
    "tables.js",
    "download.js",
    "lists.js",
    "address.js",
    "page.js",
)
_SCRIPTS: Final = {
    2: ("data.js", "theme.js", "colours.js", "raster.js", "plane.js", *_SHARED),
    3: ("data.js", "theme.js", "colours.js", "stills.js", *_SHARED),
}
"""By dimension of the mesh: one module together, each file after those it uses while it is read."""
_INERT = {ord("<"): "\\u003c", ord(">"): "\\u003e", ord("&"): "\\u0026"}
"""Names come from files and may hold ``</script>``: inside JSON these are the same characters, inert."""


def write_page(
    path: str | os.PathLike[str],
    mesh: Mesh,
    runs: Sequence[RunResult],
    note: str = "",
    registry: Registry | None = None,
    solves: Mapping[str, Mapping[str, Any]] = _NOTHING,
) -> None:
    """Write the report of several runs on one mesh, and of what was solved there, whole or not at all.

    The sections of plugins come last. One that fails is a note there and a warning in the log.

    Parameters
    ----------
    path : path
        Ends in ``.html`` or ``.htm``.
    mesh : Mesh
        A solid is shown as stills, from several sides and cut open.
    runs : sequence of RunResult
        At least one that did not fail; none if only solutions are to be reported.
    note : str
        A sentence under the title.
    registry : Registry, optional
        Where sections are looked up; by default the installed plugins.
    solves : mapping of str to mapping, optional
        Data of :func:`agglo_core.solvers.solution_report.report` by the name of solver or run, or
        ``{"error": why}``: the section Solve.

    Raises
    ------
    OptionError
        If there is neither a run nor a solution to show.
    FileError
        If the file cannot be written.
    """
    file = Path(path)
    check_page(file)
    content = _page(mesh, runs, note, default() if registry is None else registry, solves)
    try:
        with staging(file) as folder:
            (folder / file.name).write_text(content, encoding="utf-8")
    except OSError as error:
        raise FileError(f"{file}: cannot be written: {error.strerror or error}") from error


def check_page(path: Path) -> None:
    """Raise FileError unless a report can be written there, as far as can be told in advance."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise FileError(f"{path}: reports end in .html, not {path.suffix!r}")
    if not path.parent.is_dir():
        raise FileError(f"{path}: there is no folder {path.parent}")
    check_replaceable(path)


def _page(
    mesh: Mesh,
    runs: Sequence[RunResult],
    note: str,
    registry: Registry,
    solves: Mapping[str, Mapping[str, Any]],
) -> str:
    style = _text("page.css")
    about = f"{mesh.n_cells:,} cells, h0 = {mesh.h:.4g}"
    parts = {
        "<!--title-->": html.escape(mesh.name or "mesh"),
        "<!--about-->": html.escape("; ".join(filter(None, (about, note)))),
        "<!--version-->": html.escape(version_of("agglo")),
        "/*style*/": style,
        "/*style policy*/": _hash(style),
        "<!--solve-->": solve_section(solves),
        **(_of_runs(mesh, runs, note, registry) if runs or not solves else _NO_RUNS),
    }
    # in one pass: what is filled in may itself look like a mark
    page = re.sub("|".join(map(re.escape, parts)), lambda mark: parts[mark.group()], _text("page.html"))
    return page.replace("<!--size-->", f"{len(page.encode()) / 1e6:.2f}", 1)


def _of_runs(mesh: Mesh, runs: Sequence[RunResult], note: str, registry: Registry) -> dict[str, str]:
    """The parts of the page that show runs, and the script that draws them."""
    data = json.dumps(payload(mesh, runs, note), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    script = "\n".join(['"use strict";', *map(_text, _SCRIPTS[mesh.dim])])
    return {
        "/*policy*/": _hash(script),  # the one script that runs: none of a section, none of a name
        "<!--noscript-->": _text("noscript.html"),
        "<!--own-->": own_sections(),
        "<!--scripts-->": f'<script type="application/json" id="data">{data.translate(_INERT)}</script>\n'
        f'<script type="module">{script}</script>\n',
        "<!--theirs-->": sections_of_plugins(mesh, runs, registry),
    }


def _hash(text: str) -> str:
    """Hash of a script or style for the content security policy."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


def _text(name: str) -> str:
    folder = "scripts" if name.endswith(".js") else "templates"
    return (files(__package__) / folder / name).read_text(encoding="utf-8")
