"""DistributedHierarchy: coarse levels of a distributed mesh."""

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
    """Coarse levels of a distributed mesh. All methods are collective.

    Attributes
    ----------
    mesh : DistributedMesh
    levels : sequence of (n_own,) int
        Part containing each own cell, by global id in 0..k−1 over all ranks. ``levels[0]`` is the finest.
    bounds : sequence of (size + 1,) int
        Rank r owns the parts ``bounds[level][r]:bounds[level][r + 1]`` on a level, on whatever ranks
        their cells are.
    targets : sequence of mapping
        Target per level.
    nested : bool
        True if each level is a coarsening of the level before.
    statistics : mapping
        Run statistics: counts over all ranks, and CPU seconds of the slowest rank. ``messages`` and
        ``bytes`` were sent by this rank, ``sent_by_level`` for each level and its domains. The rest was
        sent before or after the levels.

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
        """Total agglomerate count per level over all ranks."""
        return [int(bounds[-1]) for bounds in self.bounds]

    def parents(self, level: int) -> Int:
        """Return the parent of each agglomerate on this rank: the agglomerate of level + 1 that contains it.

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
        for pairs in ranks.exchanged(parcels).values():
            parents[pairs[:, 0] - bounds[ranks.rank]] = pairs[:, 1]
        return frozen_int(parents)

    def prolongation(self, level: int) -> sparse.csr_array[Any, Any]:
        """Return the prolongation from ``level`` (entries 0 and 1): this rank's rows, all ranks' columns.

        Rows are this rank's agglomerates of the next finer level, or its own cells for level 0. Columns are
        global ids.
        """
        self._check(level)
        columns = self.levels[0] if level == 0 else self.parents(level - 1)
        return ones_by_row(columns, self.parts[level])

    def mesh_of(self, level: int) -> DistributedMesh:
        """Return the coarse mesh of a level. Its dual graph is ``mesh_of(level).local.graph``."""
        self._check(level)
        return self.mesh.coarsen(self.levels[level], self.bounds[level])

    def components(self, level: int) -> Int:
        """Return the number of connected components per agglomerate on this rank, normally 1."""
        self._check(level)
        return components_of_parts(self.mesh, self.levels[level], self.bounds[level])

    def quality(
        self, level: int, metrics: Iterable[Metric] = RATIOS, registry: Registry | None = None
    ) -> dict[str, float]:
        """Return the mean of each metric over all agglomerates of ``level``, equal on all ranks.

        Further entries are ``connected``, the share of connected parts, and ``max_diameter``.

        Raises
        ------
        OptionError
            For a metric that uses inner cells, or compares parts with each other (except UF).
        """
        return means(self.mesh_of(level), self.components(level), metrics, registry)

    def _check(self, level: int) -> None:
        if not 0 <= level < len(self.levels):
            raise IndexError(
                f"level {level} is out of range: the hierarchy has levels 0..{len(self.levels) - 1}"
            )
