"""What the size of a part is made of, for refiners that keep sizes in bounds."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float
from agglo_core.errors import OptionError
from agglo_core.graph import Graph

__all__ = ["SIZES", "block_sizes", "cell_sizes", "checked_size", "checked_tolerance"]

SIZES: Final[Mapping[str, str]] = MappingProxyType(
    {"cells": "cell_balance", "measure": "measure_balance", "weights": "balance"}
)
"""Kinds of size, and the objective that says how even sizes are."""


def checked_size(refiner: str, size: str) -> str:
    """A kind of size, once it is known; an OptionError otherwise."""
    if size not in SIZES:
        raise OptionError(f"{refiner}: size is one of {', '.join(SIZES)}; given {size!r}")
    return size


def checked_tolerance(refiner: str, tolerance: float) -> float:
    """A tolerance, once it is a number; an OptionError otherwise."""
    number = isinstance(tolerance, int | float | np.number) and not isinstance(tolerance, bool)
    if not (number and 0.0 <= tolerance < np.inf):
        raise OptionError(f"{refiner}: tolerance must be a number, 0 or more, not {tolerance!r}")
    return float(tolerance)


def cell_sizes(graph: Graph, size: str) -> Float:
    """What each cell ``(n,)`` adds to the size of its part."""
    if size == "cells":
        return frozen_float(np.ones(graph.n))
    return graph.measures if size == "measure" else graph.weights


def block_sizes(sizes: Float, labels: Int, block: Int) -> tuple[Float, Float]:
    """Mean size of the parts of each block ``(B,)``, and of its cells."""
    count = int(block.max(initial=-1)) + 1
    total = np.bincount(block[labels], sizes, count)
    cells, parts = np.bincount(block[labels], minlength=count), np.bincount(block, minlength=count)
    return frozen_float(total / np.maximum(parts, 1)), frozen_float(total / np.maximum(cells, 1))
