"""The hierarchy of coarse levels: labels, coarse meshes, and the maps between levels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Int, frozen_int
from agglo_core.errors import MeshError, OptionError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

__all__ = ["Hierarchy"]


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Coarse levels of a mesh or graph.

    Attributes
    ----------
    fine : Mesh or None
        The fine mesh; None if a Graph was agglomerated.
    graph : Graph
        Its dual graph.
    levels : list of (n_cells,) int
        ``levels[0]`` is the finest coarse level; labels 0..k−1 numbered by smallest cell id. One per
        target; equal levels are kept.
    targets : list of mapping
        The target of each level, e.g. ``{"h_star": 0.3}``.
    nested : bool
        Whether each level is a coarsening of the one before.
    statistics : mapping
        How the run went: plain data.
    """

    fine: Mesh | None
    graph: Graph
    levels: Sequence[Int]
    targets: Sequence[Mapping[str, Any]]
    nested: bool
    statistics: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "levels", tuple(frozen_int(labels) for labels in self.levels))
        if len(self.levels) != len(self.targets):
            raise OptionError(f"{len(self.levels)} levels but {len(self.targets)} targets")
        for labels in self.levels:
            if labels.shape != (self.graph.n,):
                raise MeshError(f"level labels have shape {labels.shape}, expected ({self.graph.n},)")

    def __repr__(self) -> str:
        return f"Hierarchy({self.graph.n} cells -> {', '.join(str(k) for k in self.parts)} parts)"

    @cached_property
    def parts(self) -> list[int]:
        """Number of agglomerates of each level."""
        return [int(labels.max()) + 1 for labels in self.levels]

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the mesh this hierarchy belongs to; empty for a graph."""
        return self.fine.fingerprint if self.fine is not None else ""

    def _level(self, level: int) -> Int:
        if not 0 <= level < len(self.levels):
            raise IndexError(f"level {level} of a hierarchy with levels 0..{len(self.levels) - 1}")
        return self.levels[level]

    def parents(self, level: int) -> Int:
        """Agglomerate of level + 1 that holds each agglomerate of ``level``, shape ``(n_level,)``.

        Raises
        ------
        ValueError
            If the hierarchy is not nested.
        """
        if not self.nested:
            raise OptionError(f"the hierarchy is not nested: use overlap({level})")
        fine, coarse = self._level(level), self._level(level + 1)
        parents = np.empty(self.parts[level], np.int64)
        parents[fine] = coarse
        return frozen_int(parents)

    def overlap(self, level: int) -> sparse.csr_array[Any, Any]:
        """Measure of the common cells, ``(n_{level+1}, n_level)``; defined for any hierarchy."""
        fine, coarse = self._level(level), self._level(level + 1)
        shape = (self.parts[level + 1], self.parts[level])
        return sparse.csr_array(sparse.coo_array((self.graph.measures, (coarse, fine)), shape=shape))

    def prolongation(self, level: int) -> sparse.csr_array[Any, Any]:
        """Injection of ones from ``level`` to the next finer one, ``(n_{level−1}, n_level)``.

        The next finer level of level 0 is the mesh itself.

        Raises
        ------
        ValueError
            If the hierarchy is not nested and ``level > 0``.
        """
        labels = self._level(level)
        columns = labels if level == 0 else self.parents(level - 1)
        rows = np.arange(len(columns))
        shape = (len(columns), self.parts[level])
        return sparse.csr_array((np.ones(len(columns)), (rows, columns)), shape=shape)

    def mesh(self, level: int) -> Mesh:
        """Mesh of the agglomerates of ``level``.

        Raises
        ------
        MeshError
            If a bare Graph was agglomerated.
        """
        if self.fine is None:
            raise MeshError("this hierarchy belongs to a graph: it has no mesh")
        return self.fine.coarsen(self._level(level))
