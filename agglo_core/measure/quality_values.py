"""Metric values on agglomerates: a dictionary displayed as a table."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Float
from agglo_core.mesh.elsewhere import import_function


class Quality(dict[str, Float]):
    """Dictionary with the values ``(k,)`` of each metric on the k agglomerates, displayed as a table.

    Examples
    --------
    >>> from agglo_core import quality, samples
    >>> quality(samples.squares(4), [0] * 8 + [1] * 8, ("CR", "cells"))
    Quality of 2 agglomerates
             mean   least  largest
    CR     0.4472  0.4472   0.4472
    cells       8       8        8
    """

    def __repr__(self) -> str:
        count = len(next(iter(self.values()), ()))
        rows: list[tuple[str, ...]] = [("", "mean", "least", "largest", "undefined")]
        for name, values in self.items():
            found = values[np.isfinite(values)]
            numbers = [f"{float(end(found)):.4g}" if len(found) else "-" for end in (np.mean, np.min, np.max)]
            rows.append((name, *numbers, str(len(values) - len(found))))
        if all(row[-1] == "0" for row in rows[1:]):
            rows = [row[:-1] for row in rows]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
            for row in rows
        ]
        return "\n".join([f"Quality of {count} agglomerate{'s' if count != 1 else ''}", *lines])

    def _repr_html_(self) -> str:
        html: str = import_function("agglo_core.draw.notebook:quality_html")(self)
        return html
