"""Cell and agglomerate colours: by neighbours, by tag with a legend, by number with a colour bar."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int
from agglo_core.errors import OptionError
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
"""Outlines of agglomerates and texts, outlines of cells, uncoloured cells."""
GRID = "#dddddd"
"""Grid lines behind curves and dots."""
LINES = ("#1f5fa8", "#c4501b", "#1b7a4b", "#8a3a9c", "#8c6d00", "#0b8499", "#b0246b", "#555555")
"""Colours of curves, dark enough for thin lines on white."""


def rgb(colour: str) -> Float:
    """Convert a colour ``#rrggbb`` to three numbers from 0 to 1."""
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0


def colouring(mesh: Mesh, n_colours: int) -> Int:
    """Colour cells ``(n_cells,)`` so that neighbours differ, as far as ``n_colours`` colours suffice.

    Greedy colouring in rounds (Jones and Plassmann): in each round, the cells that precede all uncoloured
    neighbours take a free colour. Cells with many neighbours come first.

    Examples
    --------
    >>> from agglo_core import samples
    >>> from agglo_core.draw.plot import colouring
    >>> colouring(samples.strip(4), 2)  # cells in a row
    array([1, 0, 1, 0])
    """
    graph = mesh.graph
    # Rank cells by number of neighbours, ties at random.
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    shuffled = np.random.default_rng(0).permutation(graph.n)
    rank = np.empty(graph.n, np.int64)
    rank[np.lexsort((shuffled, np.diff(graph.indptr)))] = np.arange(graph.n)
    colours = np.full(graph.n, -1, np.int64)
    is_occupied = np.zeros((graph.n, n_colours), bool)
    while (colours < 0).any():
        # Cells that precede all uncoloured neighbours.
        is_next = colours < 0
        is_next[rows[(colours[graph.indices] < 0) & (rank[graph.indices] > rank[rows])]] = False
        cells = np.flatnonzero(is_next)
        # Take a free colour, starting from a random colour.
        wish = (shuffled[cells, None] + np.arange(n_colours)) % n_colours  # equal shares of all colours
        pick = (~is_occupied[cells[:, None], wish]).argmax(axis=1)
        colours[cells] = wish[np.arange(len(cells)), pick]
        # Mark the colour as taken for the neighbours.
        is_neighbour = is_next[graph.indices]
        is_occupied[rows[is_neighbour], colours[graph.indices[is_neighbour]]] = True
    return colours


_TONES = 128
"""Steps per colour scale, which limit the number of paths, whatever the number of cells."""
_UNDEFINED = "#BBBBBB"


class Paint(NamedTuple):
    """Cell or agglomerate colours, with their legend or scale.

    ``colours (n,)`` are indices into ``palette``. ``names`` are the legend entries of the colours. ``limits``
    are the numbers at both ends of a colour scale, and ``scale`` is its matplotlib colour map.
    """

    colours: Int
    palette: tuple[str, ...]
    label: str = ""
    names: tuple[str, ...] = ()
    limits: tuple[float, float] | None = None
    scale: Any = None

    @property
    def rows(self) -> Float:
        """Red, green and blue values of each cell ``(n, 3)``, from 0 to 1."""
        tones: Float = np.array([rgb(tone) for tone in self.palette])
        return tones[self.colours]


def by_neighbours(mesh: Mesh) -> Paint:
    """Return arbitrary colours that differ between neighbour cells."""
    return Paint(colouring(mesh, len(PALETTE)), PALETTE)


def by_tag(tags: Int, label: str, cmap: str = "viridis") -> Paint:
    """Return colours by tag value ``(n,)``, or a colour scale if there are too many values."""
    values, colours = np.unique(tags, return_inverse=True)
    if len(values) > len(PALETTE):
        return by_number(tags.astype(float), label, cmap)
    return Paint(colours, PALETTE[: len(values)], label, tuple(str(value) for value in values))


def by_number(values: ArrayLike, label: str = "", cmap: str = "viridis") -> Paint:
    """Return colours of numbers ``(n,)`` on a colour scale, grey for NaN and infinities.

    Raises
    ------
    OptionError
        For an unknown matplotlib colour map.
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    if cmap not in colormaps:
        raise OptionError(
            f"cmap must be the name of a matplotlib colour map, such as 'viridis', given {cmap!r}"
        )
    numbers = np.asarray(values, dtype=np.float64)
    finite = np.isfinite(numbers)
    low, high = (float(end(numbers[finite])) for end in (np.min, np.max)) if finite.any() else (0.0, 1.0)
    steps = np.zeros(len(numbers))
    if high > low:
        steps[finite] = numbers[finite] / (high - low) - low / (high - low)
    colours = np.where(finite, np.rint((_TONES - 1) * steps.clip(0.0, 1.0)), _TONES).astype(np.int64)
    tones = [to_hex(tone) for tone in colormaps[cmap](np.linspace(0.0, 1.0, _TONES))]
    return Paint(colours, (*tones, _UNDEFINED), label, limits=(low, high), scale=colormaps[cmap])


def blank(count: int) -> Paint:
    """Return the background colour for ``count`` cells."""
    return Paint(np.zeros(count, np.int64), (PAPER,))


def explain(axis: Any, paint: Paint) -> None:
    """Add a legend or colour bar to a plot if its colours have a meaning."""
    if paint.names:
        from matplotlib.patches import Patch

        tones = zip(paint.palette, paint.names, strict=True)
        handles = [Patch(facecolor=tone, edgecolor=FINE, label=name) for tone, name in tones]
        axis.legend(handles=handles, title=paint.label, loc="center left", bbox_to_anchor=(1.0, 0.5))
    elif paint.limits is not None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        numbers = ScalarMappable(Normalize(*paint.limits), paint.scale)
        axis.get_figure().colorbar(numbers, ax=axis, label=paint.label)
