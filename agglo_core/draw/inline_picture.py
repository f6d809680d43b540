"""Small pictures inside HTML."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Sequence
from html import escape
from io import BytesIO
from typing import Any

import numpy as np

_DPI = 125  # on screen an inch has 100
_SHARES = (1.0, 0.8, 0.64, 0.5)
"""By which a picture is made smaller until it has few enough bytes."""
_BYTES = 40_000
_COLOURS = 64


def inline_picture(
    draw: Sequence[Callable[[Any], None]], about: str, *, width: float, ratio: float
) -> tuple[str, str]:
    """An ``img`` element with panels side by side, and what to say if there is none.

    Parameters
    ----------
    draw : sequence of callables
        Each draws a panel on the axes it is given; without any there is no picture.
    about : str
        What readers are told who do not see it.
    width, ratio : float
        Width of a panel in inches, and its height over that.

    Returns
    -------
    str, str
        The element, of less than 60 kB, and ``""``; or ``""`` and a reason: matplotlib is missing.
    """
    if not draw:
        return "", ""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return "", 'pictures need matplotlib: pip install "agglo[plot]"'
    figure = Figure(figsize=(width * len(draw), width * ratio + 0.2), dpi=_DPI, layout="constrained")
    for place, each in enumerate(draw):
        each(figure.add_subplot(1, len(draw), 1 + place))
    picture = _png(figure)
    source = b64encode(picture).decode()
    shown = round(100 * width * len(draw))
    element = f'<img alt="{escape(about)}" width="{shown}" src="data:image/png;base64,{source}">'
    return element, ""


def _png(figure: Any) -> bytes:
    """A figure on white as PNG of few colours, a third of the size, and of as many pixels as fit."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    drawn = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    for share in _SHARES:
        pixels = (
            drawn if share == 1.0 else drawn.resize((int(share * drawn.width), int(share * drawn.height)))
        )
        file = BytesIO()
        pixels.quantize(_COLOURS).save(file, "png", optimize=True)
        if file.tell() <= _BYTES:
            break
    return file.getvalue()
