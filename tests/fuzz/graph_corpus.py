"""Small valid graph files in METIS and Scotch formats, with coordinates and parts for equal vertices."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from agglo_core import agglomerate, samples
from agglo_core.interchange import graph_to_metis, parts_to_metis

__all__ = ["PLACES", "graph_files"]

_GRAPH = samples.squares(3).graph
PLACES = np.asarray(_GRAPH.centroids)


@cache
def graph_files() -> dict[str, list[bytes]]:
    """Return small valid files by suffix, with and without sizes, weights and comments."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "m.graph"
        graph_to_metis(file, _GRAPH)
        parts = parts_to_metis(file, agglomerate(_GRAPH, bisector="coordinate", n_parts=(4, 2)))
        written, places = file.read_bytes(), file.with_name("m.graph.xyz").read_bytes()
        return {
            ".graph": [
                written,
                *(_text(form).encode() for form in ("", "1", "10", "11", "100", "111", "011 2")),
            ],
            ".xyz": [places, places.replace(b"\n", b" 0.5\n"), places.replace(b".", b".0")],
            ".part.4": [part.read_bytes() for part in parts],
            ".grf": [_scotch(flags).encode() for flags in ("000", "001", "010", "011", "100", "111")],
            ".map": [b"9\n" + b"".join(b"%d\t%d\n" % (i * 4 % 9, i % 3) for i in range(9))],
        }


def _scotch(flags: str) -> str:
    """Return the graph with names, edge loads and vertex loads according to ``flags``."""
    lines = ["0", f"9 {len(_GRAPH.indices)}", f"0 {flags}"]
    for cell in range(9):
        neighbours = _GRAPH.indices[_GRAPH.indptr[cell] : _GRAPH.indptr[cell + 1]].tolist()
        words = [cell] * (flags[0] == "1") + [3] * (flags[2] == "1") + [len(neighbours)]
        for other in neighbours:
            words += [2 + (cell + other) % 5] * (flags[1] == "1") + [other]
        lines.append(" ".join(map(str, words)))
    return "\n".join(lines) + "\n"


def _text(form: str) -> str:
    """Return the graph with sizes and weights according to the METIS format ``form``."""
    flags, constraints = f"{(form.split() or ['0'])[0]:0>3}", int([*form.split(), "1", "1"][1]) if form else 1
    lines = ["% nine squares", f"9 {len(_GRAPH.indices) // 2} {form}".rstrip()]
    for cell in range(9):
        neighbours = _GRAPH.indices[_GRAPH.indptr[cell] : _GRAPH.indptr[cell + 1]].tolist()
        words = ["7"] * (flags[0] == "1") + ["3"] * (constraints * (flags[1] == "1"))
        for other in neighbours:
            words += [str(other + 1)] + [str(2 + (cell + other) % 5)] * (flags[2] == "1")
        lines.append(" ".join(words))
    return "\n".join(lines) + "\n"
