"""When a piece is finished: small enough, or down to the number of parts it was to become."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from agglo_core.arrays import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.graph import Graph
from agglo_core.protocols import Target

__all__ = ["ROUNDING", "ByDiameter", "ByQuota", "Rule", "apportion", "part_measures"]

ROUNDING = 1e-9
"""A part meets a size target h* if its diameter is at most h* (1 + ROUNDING)."""


class Rule(Protocol):
    """When a piece is finished. ``order`` lists the cells of the pieces, ``offsets`` cuts it."""

    @property
    def target(self) -> Target:
        """What components are told."""
        ...

    def roots(self, graph: Graph, order: Int, offsets: Int) -> tuple[Float, Mask]:
        """State of each first piece, and whether it is finished."""
        ...

    def children(self, level: Graph, order: Int, offsets: Int, state: Float) -> tuple[Float, Mask]:
        """The same for the two halves of each block, given the state of the blocks."""
        ...


@dataclass(frozen=True)
class ByDiameter:
    """Pieces are finished at ``diam <= h_star``; a single cell is, too.

    State: the diameter, exact where ``h_star`` or one of the ``coarser`` targets is near, elsewhere a
    number on the same side of all of them.
    """

    h_star: float
    coarser: tuple[float, ...] = ()

    @cached_property
    def _limits(self) -> Float:
        return frozen_float(np.sort((self.h_star, *self.coarser)) * (1 + ROUNDING))

    @property
    def target(self) -> Target:
        """What components are told."""
        return Target(h_star=self.h_star)

    def roots(self, graph: Graph, order: Int, offsets: Int) -> tuple[Float, Mask]:
        """Diameters, and whether each is small enough."""
        from agglo_core.kernels.geometry import compare_diameters

        diameter = frozen_float(
            compare_diameters(
                offsets, order, graph.vertex_offsets, graph.vertices, graph.points, self._limits
            )
        )
        return diameter, (diameter <= self.h_star * (1 + ROUNDING)) | (np.diff(offsets) == 1)

    def children(self, level: Graph, order: Int, offsets: Int, state: Float) -> tuple[Float, Mask]:
        """The same for the two halves of each block."""
        return self.roots(level, order, offsets)


@dataclass(frozen=True)
class ByQuota:
    """A piece holds a number of parts; a split shares it by measure; at 1 it is finished."""

    quotas: Int

    @property
    def target(self) -> Target:
        """What components are told."""
        return Target(parts=int(self.quotas.sum()))

    def roots(self, graph: Graph, order: Int, offsets: Int) -> tuple[Float, Mask]:
        """The given quotas."""
        return frozen_float(self.quotas), self.quotas == 1

    def children(self, level: Graph, order: Int, offsets: Int, state: Float) -> tuple[Float, Mask]:
        """``clamp(round(k · measure share), 1, min(k − 1, cells))`` on each side; they add up to k."""
        cells = np.diff(offsets).reshape(-1, 2)
        measure = np.add.reduceat(level.measures[order], offsets[:-1]).reshape(-1, 2)
        measure = np.where(measure.sum(axis=1, keepdims=True) > 0, measure, cells)
        share = measure[:, 0] / measure.sum(axis=1)
        low = np.maximum(1.0, state - cells[:, 1])
        high = np.minimum(state - 1.0, cells[:, 0])
        first = np.clip(np.round(state * share), low, high)
        quotas = np.stack((first, state - first), axis=1).ravel()
        return frozen_float(quotas), quotas == 1


def part_measures(graph: Graph, labels: Int) -> Float:
    """Measure of each part ``(k,)``."""
    return frozen_float(np.bincount(labels, weights=graph.measures))


def apportion(k: int, measures: Float, cells: Int) -> Int:
    """Share k parts among pieces by measure: at least 1 each, at most their cells, exactly k in all.

    Pieces without any measure are shared by cells.

    Raises
    ------
    OptionError
        If there are more pieces than parts, or fewer cells.
    """
    if k < len(measures):
        raise OptionError(
            f"too few parts, {k}: the mesh has {len(measures)} disconnected components, and each is a part"
        )
    if k > cells.sum():
        raise OptionError(f"too many parts, {k}: there are {int(cells.sum())} cells")
    if len(measures) == 1:
        return frozen_int([k])
    share = measures if measures.sum() > 0 else cells
    ideal = k * share / share.sum()
    low, high = -float(k), float(k)
    for _ in range(80):  # the quotas nearest to ideal + shift add up to more as the shift rises
        shift = 0.5 * (low + high)
        fits = np.clip(np.floor(ideal + shift + 0.5), 1, cells).sum() <= k
        low, high = (shift, high) if fits else (low, shift)
    quotas = np.clip(np.floor(ideal + low + 0.5), 1, cells).astype(np.int64)
    want = np.where(quotas < cells, ideal - quotas, -np.inf)
    quotas[np.argsort(-want, kind="stable")[: k - int(quotas.sum())]] += 1
    return frozen_int(quotas)
