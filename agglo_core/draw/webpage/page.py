"""HTML report from a template, a style, scripts and run data."""

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

from agglo_core.draw.webpage.estimate_curves import Curve, estimate_section
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
"""Placeholders of a page without runs."""
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
"""Scripts by mesh dimension, joined to one module, each file after its dependencies."""
_INERT = {ord("<"): "\\u003c", ord(">"): "\\u003e", ord("&"): "\\u0026"}
"""Escapes for JSON: names from files may contain ``</script>``, which these escapes make harmless."""


def write_page(
    path: str | os.PathLike[str],
    mesh: Mesh,
    runs: Sequence[RunResult],
    note: str = "",
    registry: Registry | None = None,
    solves: Mapping[str, Mapping[str, Any]] = _NOTHING,
    estimates: Mapping[str, Curve] | None = None,
) -> None:
    """Write the report on runs and solutions on one mesh, completely or not at all.

    Plugin sections come last. A failing section becomes a note on the page and a warning in the log.

    Parameters
    ----------
    path : path
        File that ends in ``.html`` or ``.htm``.
    mesh : Mesh
        Mesh. Solids are shown as stills from several sides and cut open.
    runs : sequence of RunResult
        At least one successful run, or none to report solutions only.
    note : str
        Sentence under the title.
    registry : Registry, optional
        Registry of sections. Default: the installed plugins.
    solves : mapping of str to mapping, optional
        Data for the section Solve by name of solver or run, from
        :func:`agglo_core.solvers.solution_report.report`, or ``{"error": why}``.
    estimates : mapping of str to sequence of (int, float), optional
        Unknowns and estimated errors of an adaptation, and of other meshes, by name.

    Raises
    ------
    OptionError
        Without runs and solutions.
    FileError
        If the file cannot be written.
    """
    file = Path(path)
    check_page(file)
    content = _page(mesh, runs, note, default() if registry is None else registry, solves, estimates or {})
    try:
        with staging(file) as folder:
            (folder / file.name).write_text(content, encoding="utf-8")
    except OSError as error:
        raise FileError(f"{file}: cannot be written: {error.strerror or error}") from error


def check_page(path: Path) -> None:
    """Raise FileError if the report can foreseeably not be written to this path."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise FileError(f"{path}: reports end in .html, given {path.suffix!r}")
    if not path.parent.is_dir():
        raise FileError(f"{path}: there is no folder {path.parent}")
    check_replaceable(path)


def _page(
    mesh: Mesh,
    runs: Sequence[RunResult],
    note: str,
    registry: Registry,
    solves: Mapping[str, Mapping[str, Any]],
    estimates: Mapping[str, Curve],
) -> str:
    style = _text("page.css")
    about = f"{mesh.n_cells:,} cells, h0 = {mesh.h:.4g}"
    parts = {
        "<!--title-->": html.escape(mesh.name or "mesh"),
        "<!--about-->": html.escape("; ".join(filter(None, (about, note)))),
        "<!--version-->": html.escape(version_of("agglo")),
        "/*style*/": style,
        "/*style policy*/": _hash(style),
        "<!--solve-->": estimate_section(estimates) + solve_section(solves),
        **(_of_runs(mesh, runs, note, registry) if runs or not solves else _NO_RUNS),
    }
    # Fill in one pass, because filled-in text may itself look like a mark.
    page = re.sub("|".join(map(re.escape, parts)), lambda mark: parts[mark.group()], _text("page.html"))
    return page.replace("<!--size-->", f"{len(page.encode()) / 1e6:.2f}", 1)


def _of_runs(mesh: Mesh, runs: Sequence[RunResult], note: str, registry: Registry) -> dict[str, str]:
    """Return the parts of the report that show runs, and the script that draws them."""
    data = json.dumps(payload(mesh, runs, note), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    script = "\n".join(['"use strict";', *map(_text, _SCRIPTS[mesh.dim])])
    return {
        "/*policy*/": _hash(script),  # the only script allowed to run
        "<!--noscript-->": _text("noscript.html"),
        "<!--own-->": own_sections(),
        "<!--scripts-->": f'<script type="application/json" id="data">{data.translate(_INERT)}</script>\n'
        f'<script type="module">{script}</script>\n',
        "<!--theirs-->": sections_of_plugins(mesh, runs, registry),
    }


def _hash(text: str) -> str:
    """Return the hash of a script or style, by which the browser accepts it (content security policy)."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


def _text(name: str) -> str:
    folder = "scripts" if name.endswith(".js") else "templates"
    return (files(__package__) / folder / name).read_text(encoding="utf-8")
