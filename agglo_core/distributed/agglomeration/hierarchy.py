"""DistributedHierarchy: the coarse levels of a distributed mesh."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.agglomeration.part_components import components_of_parts
from agglo_core.distributed.agglomeration.part_metrics import means
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.errors import OptionError
from agglo_core.hierarchy.cuts import ones_by_row
from agglo_core.measure.selection import RATIOS, Metric
from agglo_core.registry import Registry


@dataclass(frozen=True, eq=False)
class DistributedHierarchy:
    """Coarse levels of a distributed mesh. All ranks must call its methods together.

    Attributes
    ----------
    mesh : DistributedMesh
    levels : sequence of (n_own,) int
        ``levels[0]`` is the finest: the part of each own cell, by its global id, 0..k−1 over all ranks.
    bounds : sequence of (size + 1,) int
        Rank r has the parts ``bounds[level][r]:bounds[level][r + 1]`` of a level, whatever ranks their
        cells lie on.
    targets : sequence of mapping
        The target of each level.
    nested : bool
        Whether each level is a coarsening of the one before.
    statistics : mapping
        How the run went: counts of all ranks, CPU seconds of the slowest one; ``messages`` and ``bytes`` that
        this rank has sent, in ``sent_by_level`` those for each level, also to make its domains; the rest came
        before the levels, or after.

    Examples
    --------
    >>> from agglo_core import Pipeline, distributed, samples
    >>> mesh = distributed.DistributedMesh.scatter(samples.squares(8))
    >>> hierarchy = distributed.agglomerate(mesh, Pipeline(n_parts=(16, 4)))
    >>> hierarchy.prolongation(1).shape, hierarchy.quality(0, ["UF"])["UF"]
    ((16, 4), 1.0)
    """

    mesh: DistributedMesh
    levels: Sequence[Int]
    bounds: Sequence[Int]
    targets: Sequence[Mapping[str, Any]]
    nested: bool
    statistics: Mapping[str, Any]

    def __repr__(self) -> str:
        counts = ", ".join(str(k) for k in self.parts)
        return f"DistributedHierarchy({self.mesh.n_cells} cells -> {counts} parts; {self.mesh.ranks})"

    @property
    def parts(self) -> list[int]:
        """Number of agglomerates of each level, on all ranks."""
        return [int(bounds[-1]) for bounds in self.bounds]

    def parents(self, level: int) -> Int:
        """Agglomerate of level + 1 that holds each agglomerate of ``level`` that this rank has.

        Raises
        ------
        OptionError
            If the hierarchy is not nested.
        """
        if not self.nested:
            raise OptionError("the hierarchy is not nested: parts have no parents")
        self._check(level + 1)
        bounds, ranks = self.bounds[level], self.mesh.ranks
        pairs = np.unique(np.stack((self.levels[level], self.levels[level + 1]), axis=1), axis=0)
        owner = np.searchsorted(bounds, pairs[:, 0], side="right") - 1
        parcels: dict[int, NDArray[Any]] = {rank: pairs[owner == rank] for rank in np.unique(owner).tolist()}
        parents = np.empty(bounds[ranks.rank + 1] - bounds[ranks.rank], np.int64)
        for told in ranks.exchanged(parcels).values():
            parents[told[:, 0] - bounds[ranks.rank]] = told[:, 1]
        return frozen_int(parents)

    def prolongation(self, level: int) -> sparse.csr_array[Any, Any]:
        """Injection of ones from ``level`` to the next finer one: the rows of this rank, all columns.

        Rows are the agglomerates of the next finer level that this rank has, for level 0 its own cells;
        columns are global ids.
        """
        self._check(level)
        columns = self.levels[0] if level == 0 else self.parents(level - 1)
        return ones_by_row(columns, self.parts[level])

    def mesh_of(self, level: int) -> DistributedMesh:
        """Mesh of the agglomerates of ``level``; its graph across ranks is ``mesh_of(level).local.graph``."""
        self._check(level)
        return self.mesh.coarsen(self.levels[level], self.bounds[level])

    def components(self, level: int) -> Int:
        """Number of connected components of each agglomerate of ``level`` that this rank has: 1 each."""
        self._check(level)
        return components_of_parts(self.mesh, self.levels[level], self.bounds[level])

    def quality(
        self, level: int, metrics: Iterable[Metric] = RATIOS, registry: Registry | None = None
    ) -> dict[str, float]:
        """Means of metrics over all agglomerates of ``level``, the same on all ranks.

        Besides the metrics: ``connected``, the share of connected parts, and ``max_diameter``.

        Raises
        ------
        OptionError
            For a metric that looks at the cells inside, or compares parts with one another (except UF).
        """
        return means(self.mesh_of(level), self.components(level), metrics, registry)

    def _check(self, level: int) -> None:
        if not 0 <= level < len(self.levels):
            raise IndexError(f"level {level} of a hierarchy with levels 0..{len(self.levels) - 1}")
