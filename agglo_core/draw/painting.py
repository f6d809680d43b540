"""Colours of cells and what explains them: neighbours that differ, tags with a legend, numbers with a bar."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int
from agglo_core.draw.colours import PALETTE, PAPER, colouring
from agglo_core.draw.solids.shading import rgb
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh

_TONES = 128
"""Steps of a colour scale: as many paths are drawn at most, whatever the number of cells."""
_UNDEFINED = "#BBBBBB"


class Paint(NamedTuple):
    """A colour for each cell or agglomerate.

    ``colours (n,)`` are places in ``palette``. ``names`` are those of the colours in a legend, by their
    place; ``limits`` the numbers at both ends of a colour scale, ``scale`` its colour map of matplotlib.
    """

    colours: Int
    palette: tuple[str, ...]
    label: str = ""
    names: tuple[str, ...] = ()
    limits: tuple[float, float] | None = None
    scale: Any = None

    @property
    def rows(self) -> Float:
        """Red, green and blue of each cell ``(n, 3)``, from 0 to 1."""
        tones: Float = np.array([rgb(tone) for tone in self.palette])
        return tones[self.colours]


def by_neighbours(mesh: Mesh) -> Paint:
    """Colours without meaning: those of neighbours differ."""
    return Paint(colouring(mesh, len(PALETTE)), PALETTE)


def by_tag(tags: Int, label: str, cmap: str = "viridis") -> Paint:
    """One colour for each tag ``(n,)``; tags of more values than there are colours, as numbers."""
    values, colours = np.unique(tags, return_inverse=True)
    if len(values) > len(PALETTE):
        return by_number(tags.astype(float), label, cmap)
    return Paint(colours, PALETTE[: len(values)], label, tuple(str(value) for value in values))


def by_number(values: ArrayLike, label: str = "", cmap: str = "viridis") -> Paint:
    """Numbers ``(n,)`` on a colour scale; grey where they are not finite.

    Raises
    ------
    OptionError
        If matplotlib has no colour map of that name.
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    if cmap not in colormaps:
        raise OptionError(
            f"cmap must be the name of a colour map of matplotlib, such as 'viridis', not {cmap!r}"
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
    """No colour for ``count`` cells."""
    return Paint(np.zeros(count, np.int64), (PAPER,))


def explain(axis: Any, paint: Paint) -> None:
    """Put the legend or the colour bar of a paint beside a plot; colours without meaning have none."""
    if paint.names:
        from matplotlib.patches import Patch

        tones = zip(paint.palette, paint.names, strict=True)
        handles = [Patch(facecolor=tone, edgecolor="#777777", label=name) for tone, name in tones]
        axis.legend(handles=handles, title=paint.label, loc="center left", bbox_to_anchor=(1.0, 0.5))
    elif paint.limits is not None:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        numbers = ScalarMappable(Normalize(*paint.limits), paint.scale)
        axis.get_figure().colorbar(numbers, ax=axis, label=paint.label)
