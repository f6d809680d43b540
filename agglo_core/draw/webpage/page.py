"""The HTML file: template, style and script of this folder with the data of a comparison inside."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from agglo_core.draw.webpage.payload import payload
from agglo_core.draw.webpage.sections import own_sections, sections_of_plugins
from agglo_core.errors import FileError
from agglo_core.io.atomic import check_replaceable, staging
from agglo_core.measure.comparison import RunResult
from agglo_core.mesh import Mesh
from agglo_core.registry import Registry, default

__all__ = ["check_page", "write_page"]

_SCRIPTS = ("data.js", "map.js", "charts.js", "page.js")
_INERT = {ord("<"): "\\u003c", ord(">"): "\\u003e", ord("&"): "\\u0026"}
"""Names come from files and may hold ``</script>``: inside JSON these are the same characters, inert."""


def write_page(
    path: str | os.PathLike[str],
    mesh: Mesh,
    runs: Sequence[RunResult],
    note: str = "",
    registry: Registry | None = None,
) -> None:
    """Write the report of several runs on one mesh, whole or not at all.

    The sections of plugins come last. One that fails is a note there and a warning in the log.

    Parameters
    ----------
    path : path
        Ends in ``.html`` or ``.htm``.
    mesh : Mesh
        2-D.
    runs : sequence of RunResult
        At least one that did not fail.
    note : str
        A sentence under the title.
    registry : Registry, optional
        Where sections are looked up; by default the installed plugins.

    Raises
    ------
    MeshError
        For a 3-D mesh.
    OptionError
        If there is no run to show.
    FileError
        If the file cannot be written.
    """
    file = Path(path)
    check_page(file)
    content = _page(mesh, runs, note, default() if registry is None else registry)
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


def _page(mesh: Mesh, runs: Sequence[RunResult], note: str, registry: Registry) -> str:
    here = files(__package__)
    data = json.dumps(payload(mesh, runs, note), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    script = "\n".join(['"use strict";', *((here / name).read_text(encoding="utf-8") for name in _SCRIPTS)])
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    parts = {
        "<!--title-->": html.escape(mesh.name or "mesh"),
        "/*style*/": (here / "page.css").read_text(encoding="utf-8"),
        "/*digest*/": f"sha256-{digest}",  # the one script that runs: none of a section, none of a name
        "/*script*/": script,
        "/*data*/": data.translate(_INERT),
        "<!--own-->": own_sections(),
        "<!--theirs-->": sections_of_plugins(mesh, runs, registry),
    }
    template = (here / "page.html").read_text(encoding="utf-8")
    # in one pass: what is filled in may itself look like a mark
    return re.sub("|".join(map(re.escape, parts)), lambda mark: parts[mark.group()], template)
