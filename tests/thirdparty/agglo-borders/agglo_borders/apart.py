"""Constraint ``apart``."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Graph, Mask, OptionError

__all__ = ["Apart"]


class Apart:
    """Forbid parts with different values of a tag.

    Parameters
    ----------
    tag : str
        Name of the cell tag.
    """

    def __init__(self, tag: str = "region") -> None:
        self.tag = tag

    def forbidden(self, graph: Graph) -> Mask:
        """Return a mask ``(m,)`` of the graph entries between cells of different tags."""
        if self.tag not in graph.data:
            raise OptionError(f"apart: no cell tag is named {self.tag!r}; there are {', '.join(graph.data)}")
        values = graph.data[self.tag]
        return np.repeat(values, np.diff(graph.indptr)) != values[graph.indices]
