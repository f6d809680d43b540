"""Part sizes with their bounds, and refinement of a whole level block by block."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.graph.loads import Kind
from agglo_core.graph.objectives import numbered_parts
from agglo_core.protocols import Target

SIZES: Final[Mapping[Kind | None, str]] = MappingProxyType(
    {None: "run_balance", "cells": "cell_balance", "measure": "measure_balance", "weights": "balance"}
)
"""Kinds of size and the objectives that measure the imbalance. None is the quantity that the run balances."""


class Balance(NamedTuple):
    """Balance requirement: relative tolerance of part sizes about their mean, and the kind of size."""

    tolerance: float
    size: Kind | None = None

    @property
    def bounded(self) -> bool:
        """True if the part sizes are bounded."""
        return self.tolerance < np.inf

    def bounds(self, sizes: Float, k: int) -> tuple[float, float, float]:
        """Return the smallest and largest size of k parts, and the mean cell size, from ``sizes (n,)``."""
        mean, cell = float(sizes.sum()) / k, float(sizes.mean())
        far = self.tolerance * mean if self.bounded else np.inf
        return mean - far, mean + far, cell if cell > 0.0 else 1.0

    def holds(self, sizes: Float, labels: Int) -> bool:
        """Return True if all parts are within the tolerance, or less than a mean cell from the mean."""
        if not self.bounded:
            return True
        each = np.bincount(labels, sizes)
        room = max(self.tolerance * float(each.mean()), float(sizes.mean()))
        return bool(np.abs(each - each.mean()).max() <= room * (1.0 + 1e-9))


FREE: Final = Balance(np.inf)
"""Balance without bounds."""


def check_size(refiner: str, size: Any) -> Kind | None:
    """Check that ``size`` is a kind of part size, such as measure, and return it."""
    if size not in SIZES:
        raise OptionError(f"{refiner}: size must be one of {', '.join(filter(None, SIZES))}; given {size!r}")
    return size  # type: ignore[no-any-return]


def check_tolerance(refiner: str, tolerance: float, name: str = "tolerance") -> float:
    """Check that the tolerance is a number, 0 or more, and return it as a float."""
    number = isinstance(tolerance, int | float | np.number) and not isinstance(tolerance, bool)
    if not (number and 0.0 <= tolerance < np.inf):
        raise OptionError(f"{refiner}: {name} must be a number, 0 or more, not {tolerance!r}")
    return float(tolerance)


def block_sizes(sizes: Float, labels: Int, block: Int) -> tuple[Float, Float]:
    """Return the mean part size and the mean cell size in each block, ``(B,)`` each."""
    count = int(block.max(initial=-1)) + 1
    total = np.bincount(block[labels], sizes, count)
    cells, parts = np.bincount(block[labels], minlength=count), np.bincount(block, minlength=count)
    return frozen_float(total / np.maximum(parts, 1)), frozen_float(total / np.maximum(cells, 1))


class _OfParts(Protocol):
    def refine_parts(self, graph: Graph, labels: Int, block: Int, target: Target) -> Int: ...


def refine_blocks(refiner: _OfParts, graph: Graph, labels: Int, target: Target) -> Int:
    """Apply ``refine_parts`` to all blocks of a graph, and return labels ``(n,)`` numbered per block."""
    parts = numbered_parts(graph, labels)
    k = int(parts.max(initial=-1)) + 1
    local, block = np.empty(k, np.int64), np.empty(k, np.int64)
    local[parts], block[parts] = labels, graph.block_ids
    return frozen_int(local[refiner.refine_parts(graph, parts, frozen_int(block), target)])
