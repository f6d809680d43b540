"""Flat arrays with the data of many mesh pieces: joining, and selection of pieces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from agglo_core.authoring import Int


def join_arrays(levels: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Concatenate equally named arrays of several graphs.

    Arrays named ``*_offsets`` contain counts and become offsets.

    Examples
    --------
    >>> levels = [{"cells": [1.0, 2.0, 3.0], "cell_offsets": [2, 1]}, {"cells": [4.0], "cell_offsets": [1]}]
    >>> joined_arrays(levels)["cell_offsets"].tolist()
    [0, 2, 3, 4]
    """
    arrays = {key: np.concatenate([level[key] for level in levels]) for key in levels[0]}
    return {
        key: np.concatenate(([0], np.cumsum(values))) if key.endswith("_offsets") else values
        for key, values in arrays.items()
    }


def rows_of(offsets: Int, chosen: Int) -> tuple[Int, Int, Int]:
    """Return the row indices of the chosen pieces, each row's piece, and the new offsets."""
    sizes = np.diff(offsets)[chosen]
    first = np.cumsum(sizes) - sizes
    owner = np.repeat(np.arange(len(chosen)), sizes)
    return np.arange(sizes.sum()) + (offsets[chosen] - first)[owner], owner, first
