"""Cuts through nested hierarchies: coarse meshes whose parts come from different levels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from agglo_core.arrays import (
    Float,
    Int,
    Mask,
    first_of_each,
    frozen_float,
    frozen_int,
    index_cast,
    plain_array,
)
from agglo_core.errors import MeshError, OptionError
from agglo_core.graph import Graph
from agglo_core.hierarchy.cut_search import grade_cut
from agglo_core.hierarchy.forest import Forest
from agglo_core.mesh import Mesh


class Change(NamedTuple):
    """Result of local refinement or coarsening: the new cut, and a map from old to new parts.

    Attributes
    ----------
    cut : Cut
        The new cut.
    same : (n_parts of the old cut,) int
        New number of each unchanged part, −1 for changed parts.
    pairs : (k, 2) int
        Old and new numbers of changed parts: a refined part occurs with each of its new parts, and joined
        parts occur with their union.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> mesh = agglo.samples.squares(4)
    >>> cut = agglo.agglomerate(mesh, n_parts=(4, 2)).cut(2)
    >>> change = cut.refine([0])  # the first part becomes those below it
    >>> change.cut.n_parts, change.same, change.pairs
    (3, array([-1,  2]), array([[0, 0],
           [0, 1]]))
    """

    cut: Cut
    same: Int
    pairs: Int


@dataclass(frozen=True, eq=False)
class Cut:
    """A coarse mesh with parts from several levels, created by :meth:`~agglo_core.hierarchy.Hierarchy.cut`.

    Attributes
    ----------
    fine : Mesh or None
        The fine mesh; None if a Graph was agglomerated.
    graph : Graph
        Its dual graph.
    forest : Forest
        The levels of the hierarchy as trees.
    nodes : (n_parts,) int
        Forest node per part.
    grade : int or None
        Maximum level difference between adjacent parts; None for no limit.

    Examples
    --------
    >>> hierarchy = agglo.agglomerate(agglo.samples.squares(8), n_parts=(16, 4))
    >>> cut = hierarchy.cut_at(1).refine([0]).cut
    >>> cut.n_parts, cut.levels.tolist()
    (7, [0, 0, 1, 0, 0, 1, 1])
    """

    fine: Mesh | None
    graph: Graph
    forest: Forest
    nodes: Int
    grade: int | None = None

    def __post_init__(self) -> None:
        labels, nodes = self.forest.labelled(self.nodes)
        object.__setattr__(self, "nodes", nodes)
        object.__setattr__(self, "_labels", labels)

    def __repr__(self) -> str:
        levels = f"{self.levels.min()}..{self.levels.max()}"
        return f"Cut({self.graph.n} cells -> {self.n_parts} parts of levels {levels})"

    @property
    def labels(self) -> Int:
        """Part of each cell ``(n,)``, with parts numbered by their smallest cell indices."""
        labels: Int = self.__dict__["_labels"]
        return labels

    @property
    def n_parts(self) -> int:
        """Part count."""
        return len(self.nodes)

    @property
    def levels(self) -> Int:
        """Level of each part ``(n_parts,)``, the coarsest one that contains it.

        Single cells have −1.
        """
        return frozen_int(self.forest.coarsest[self.nodes])

    @cached_property
    def measures(self) -> Float:
        """Measure of each part ``(n_parts,)``."""
        return frozen_float(np.bincount(self.labels, self.graph.measures))

    @cached_property
    def mesh(self) -> Mesh:
        """Mesh whose cells are the parts.

        Raises
        ------
        MeshError
            If a Graph without mesh was agglomerated.
        """
        if self.fine is None:
            raise MeshError(
                "this cut belongs to a graph without a mesh: agglomerate the Mesh instead of its graph"
            )
        return self.fine.coarsen(self.labels)

    # -- local changes -------------------------------------------------------------------------
    def refine(self, parts: ArrayLike) -> Change:
        """Split the given parts into their parts on the next finer level.

        With a grade, neighbours are split as necessary.

        Parameters
        ----------
        parts : (k,) int or (n_parts,) bool
            Single cells are unchanged.
        """
        is_split = self._mask(parts) & (self.forest.n_children[self.nodes] > 0)
        split_nodes = self.nodes[is_split]
        children = _ranges(self.forest.first_child[split_nodes], self.forest.n_children[split_nodes])
        return self._changed(np.concatenate((self.nodes[~is_split], children)))

    def coarsen(self, parts: ArrayLike) -> Change:
        """Join the given parts into those of the next coarser level, where all siblings are given.

        Other parts are unchanged, as are, with a grade, parts with too fine neighbours. Pieces from
        :meth:`refine` become the original part again if all are given.

        Parameters
        ----------
        parts : (k,) int or (n_parts,) bool
        """
        mask = self._mask(parts)
        above = self.forest.parent[self.nodes]
        n_chosen = np.bincount(above[mask & (above >= 0)], minlength=len(self.forest.parent))
        whole = (n_chosen > 0) & (n_chosen == self.forest.n_children)
        is_joined = (above >= 0) & whole[above]
        return self._changed(np.concatenate((self.nodes[~is_joined], np.flatnonzero(whole))))

    def _mask(self, parts: ArrayLike) -> Mask:
        array = plain_array(parts, "parts", OptionError)
        if array.dtype == bool and array.shape == (self.n_parts,):
            return array
        if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
            raise OptionError(
                f"parts must be part numbers, or a mask of shape ({self.n_parts},); given shape "
                f"{array.shape}, dtype {array.dtype}"
            )
        if array.size and (array.min() < 0 or array.max() >= self.n_parts):
            raise OptionError(f"parts must lie in 0..{self.n_parts - 1}; given {array.min()}..{array.max()}")
        mask = np.zeros(self.n_parts, bool)
        mask[array.astype(np.int64)] = True
        return mask

    def _changed(self, nodes: Int) -> Change:
        if self.grade is not None:
            nodes = grade_cut(self.forest, self.graph, frozen_int(nodes), self.grade)
        new = Cut(self.fine, self.graph, self.forest, frozen_int(nodes), self.grade)
        number = np.full(len(self.forest.parent), -1)
        number[new.nodes] = np.arange(new.n_parts)
        new_part = number[self.nodes]
        is_changed = new_part[self.labels] < 0
        pairs = _pairs(self.labels[is_changed], new.labels[is_changed], new.n_parts)
        return Change(new, frozen_int(new_part), pairs)

    # -- transfer ------------------------------------------------------------------------------
    def prolongation(self, finer: Cut) -> sparse.csr_array[Any, Any]:
        """Return the 0-1 prolongation of piecewise constants to a finer cut, ``(finer.n_parts, n_parts)``.

        Prolongations between three cuts compose: the product over an intermediate cut is the direct
        prolongation.

        Raises
        ------
        OptionError
            If ``finer`` is no refinement of this cut, or belongs to another hierarchy.
        """
        self._check_same_forest(finer)
        columns = self.labels[first_of_each(finer.labels)]
        if (columns[finer.labels] != self.labels).any():
            raise OptionError(
                f"{finer!r} is not a refinement of {self!r}; use projection, which accepts any two cuts"
            )
        return ones_by_row(columns, self.n_parts)

    def restriction(self, coarser: Cut) -> sparse.csr_array[Any, Any]:
        """Return measure-weighted averaging to a coarser cut as a matrix, ``(coarser.n_parts, n_parts)``.

        It is the left inverse of :meth:`prolongation`: R P is the identity.

        Raises
        ------
        OptionError
            If this cut is no refinement of ``coarser``, or belongs to another hierarchy.
        """
        coarser.prolongation(self)
        return self.projection(coarser)

    def projection(self, other: Cut) -> sparse.csr_array[Any, Any]:
        """Return measure-weighted averaging to any other cut, locally finer or coarser, as a matrix.

        It is the L2 projection for piecewise constants, and preserves the integral.

        Raises
        ------
        OptionError
            If the cut belongs to another hierarchy.
        """
        self._check_same_forest(other)
        shape = (other.n_parts, self.n_parts)
        places = tuple(index_cast(labels, self.graph.n) for labels in (other.labels, self.labels))
        common = sparse.csr_array(sparse.coo_array((self.graph.measures, places), shape=shape))
        rows = np.repeat(np.arange(other.n_parts), np.diff(common.indptr))
        total = np.bincount(rows, common.data, other.n_parts)
        common.data /= total[rows]
        return common

    def overlaps(self, other: Cut) -> Int:
        """Return the pairs of overlapping parts of this and another cut, ``(k, 2)`` in ascending order.

        One part of each pair contains the other.

        Raises
        ------
        OptionError
            If the cut belongs to another hierarchy.
        """
        self._check_same_forest(other)
        # One part of a pair contains the other, and therefore the first cell of the other
        cells = np.concatenate([first_of_each(cut.labels) for cut in (self, other)])
        return _pairs(self.labels[cells], other.labels[cells], other.n_parts)

    def _check_same_forest(self, other: Cut) -> None:
        if not self.forest.matches(other.forest):
            raise OptionError("the cuts belong to different hierarchies: there is no transfer between them")


def _pairs(parts: Int, others: Int, n_others: int) -> Int:
    """Return the different pairs of parts that cells ``(n,)`` have in two partitions, ``(k, 2)``."""
    codes = np.unique(parts * n_others + others)
    return frozen_int(np.stack(np.divmod(codes, n_others), axis=1))


def ones_by_row(columns: Int, n_columns: int) -> sparse.csr_array[Any, Any]:
    """Return the sparse matrix ``(n, n_columns)`` with a single one in row i, in ``columns[i]``."""
    n = len(columns)
    indices, indptr = (index_cast(array, max(n, n_columns)) for array in (columns, np.arange(n + 1)))
    return sparse.csr_array((np.ones(n), indices, indptr), shape=(n, n_columns))


def _ranges(first: Int, count: Int) -> Int:
    """Concatenate the ranges of ``count[i]`` consecutive integers that start at ``first[i]``."""
    ends = np.cumsum(count)
    return frozen_int(np.arange(ends[-1] if len(ends) else 0) + np.repeat(first - ends + count, count))
