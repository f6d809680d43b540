"""Colours of agglomerates: neighbours differ."""

from __future__ import annotations

import numpy as np

from agglo_core.arrays import Int
from agglo_core.mesh import Mesh

PALETTE = (  # Paul Tol's "light" scheme, safe for colour-blind readers, and two more
    "#77AADD",
    "#EE8866",
    "#EEDD88",
    "#99DDFF",
    "#FFAABB",
    "#44BB99",
    "#C9A6DD",
    "#BBCC33",
    "#B5DBA4",
)
INK, FINE, PAPER = "#222222", "#777777", "#F4F1EA"
"""Outlines of agglomerates, those of cells, and cells of no agglomerate."""


def colouring(mesh: Mesh, n_colours: int) -> Int:
    """Colour of each cell ``(n_cells,)``, different from its neighbours' wherever a colour is left.

    Rounds of greedy colouring (Jones and Plassmann): in each, the cells that precede all their
    uncoloured neighbours take a free colour. Cells of many neighbours come first.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.draw.plot import colouring
    >>> colouring(samples.strip(4), 2)  # cells in a row
    array([1, 0, 1, 0])
    """
    graph = mesh.graph
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    shuffled = np.random.default_rng(0).permutation(graph.n)
    rank = np.empty(graph.n, np.int64)
    rank[np.lexsort((shuffled, np.diff(graph.indptr)))] = np.arange(graph.n)
    colours = np.full(graph.n, -1, np.int64)
    taken = np.zeros((graph.n, n_colours), bool)
    while (colours < 0).any():
        ready = colours < 0
        ready[rows[(colours[graph.indices] < 0) & (rank[graph.indices] > rank[rows])]] = False
        chosen = np.flatnonzero(ready)
        wish = (shuffled[chosen, None] + np.arange(n_colours)) % n_colours  # all colours in equal share
        pick = (~taken[chosen[:, None], wish]).argmax(axis=1)
        colours[chosen] = wish[np.arange(len(chosen)), pick]
        told = ready[graph.indices]
        taken[rows[told], colours[graph.indices[told]]] = True
    return colours
