"""Comparison of bisector cut costs with those of 2-means clustering."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

import numpy as np

from agglo_core.authoring import Float, Graph, Int, UInt64, default

Rival = Callable[[Graph, UInt64], Int]
"""Function that returns the sides ``(n,)`` of the cells in a graph, block by block."""


class CutCosts(NamedTuple):
    """Cut costs of several bisectors and 2-means on the same pieces, and the piece sizes."""

    of: dict[str, Float]
    base: Float
    sizes: Int

    def mean_ratios(self, large: int) -> dict[str, float]:
        """Return each bisector's mean cost ratio to 2-means, and the same for large pieces alone.

        The keys of the latter end in ``_<large>``.

        Large pieces have at least ``large`` cells.
        """
        is_large = self.sizes >= large
        ratios = {key: values / self.base for key, values in self.of.items()}
        return {key: float(values.mean()) for key, values in ratios.items()} | {
            f"{key}_{large}": float(values[is_large].mean()) for key, values in ratios.items()
        }


def measure_costs(levels: Iterable[Graph], rivals: Mapping[str, Rival]) -> CutCosts:
    """Compute the cut cost of every block in some graphs for several bisectors and for 2-means."""
    two_means: Rival = default().build("bisector", "kmeans").bisect_level
    costs: dict[str, list[Float]] = {key: [] for key in rivals}
    base, sizes = list[Float](), list[Int]()
    for level in levels:
        seeds = np.zeros(level.n_blocks, np.uint64)
        sizes.append(level.sizes)
        base.append(cut_costs(level, np.asarray(two_means(level, seeds))))
        for key, rival in rivals.items():
            costs[key].append(cut_costs(level, np.asarray(rival(level, seeds))))
    joined = {key: np.concatenate(values) for key, values in costs.items()}
    return CutCosts(joined, np.concatenate(base), np.concatenate(sizes))


def cut_costs(level: Graph, sides: Int) -> Float:
    """Return each block's cut cost: scaled interface plus inertia of both sides.

    It is cut · √A (1/A₁ + 1/A₂) + 15 (1 − B/T), in 3-D with ∛A.
    """
    # 1. Interface between the sides
    block, count = level.block_ids, level.n_blocks
    rows = np.repeat(np.arange(level.n), np.diff(level.indptr))
    crossing = sides[rows] != sides[level.indices]
    cut = 0.5 * np.bincount(block[rows], level.interface * crossing, minlength=count)
    # 2. Measure and first moments of both sides
    part = 2 * block + sides
    area = np.bincount(part, level.measures, minlength=2 * count).reshape(-1, 2)
    moment = [
        np.bincount(part, level.measures * x, minlength=2 * count).reshape(-1, 2) for x in level.centroids.T
    ]
    # 3. Inertia, total and within the sides
    total = area.sum(axis=1)
    inertia = np.bincount(block, level.measures * (level.centroids**2).sum(axis=1), minlength=count)
    mean = sum(m.sum(axis=1) ** 2 for m in moment) / total
    within = inertia - sum((m**2 / area).sum(axis=1) for m in moment)
    length = np.sqrt(total) if level.dim == 2 else np.cbrt(total)
    costs: Float = cut * length * (1 / area).sum(axis=1) + 15 * within / (inertia - mean)
    return costs
