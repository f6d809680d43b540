"""Report section ``sizes``."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

from agglo_core.authoring import Mesh

__all__ = ["Sizes"]


class Sizes:
    """Number of parts of each level in each run."""

    title = "Parts of every level"

    def html(self, mesh: Mesh, runs: Sequence[Any]) -> str:
        """Return a list of the runs."""
        done = [(run.name, run.hierarchy) for run in runs if run.hierarchy is not None]
        items = (f"<li>{escape(name)}: {', '.join(map(str, it.parts))} parts</li>" for name, it in done)
        return f"<p>{escape(mesh.name)}, {mesh.n_cells} cells</p><ul>{''.join(items)}</ul>"
