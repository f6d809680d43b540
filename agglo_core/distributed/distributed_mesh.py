"""DistributedMesh: a mesh whose cells lie on the ranks of MPI, each with one layer of ghosts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Int, Mask, frozen, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.halo import common_origin, ghosts, local_mesh, own_cells
from agglo_core.distributed.moving import moved
from agglo_core.distributed.sharing import scattered
from agglo_core.distributed.whole_cells import WholeCells, joined
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh

__all__ = ["DistributedMesh"]


@dataclass(frozen=True, eq=False)
class DistributedMesh:
    """A mesh whose cells lie on the ranks of MPI: each has its own cells, and their neighbours as ghosts.

    Build one with :meth:`scatter`, :meth:`from_local` or :meth:`from_pieces`. All ranks must call these, and
    all other methods, together. What is computed of own cells (measures, centroids, interfaces) does
    not depend on the number of ranks, not in the last bit: cells, faces and points of the local mesh are in
    the order of their global numbers, and its ``origin`` is that of the whole mesh. Of ghosts it may differ
    by rounding; :meth:`exchange` brings the values of their owners.

    A rank may have no cells: its local mesh has none then, and no faces and points.

    Attributes
    ----------
    ranks : Ranks
    local : Mesh
        Own cells and ghosts (all cells of other ranks that share a face with an own one) by global id.
    global_ids : (local.n_cells,) int
        Rising.
    owners : (local.n_cells,) int
        Rank that has each cell as its own.
    point_ids : (local.n_points,) int
        Global id of each point, rising.
    face_ids : (local.n_faces,) int
        Global number of each face, rising; some may not be in use.
    hidden : (local.n_faces,) bool
        Faces of ghosts that look like outer ones, but lead to cells that are not here. They are in no tag.
    n_cells : int
        Number of cells of the whole mesh.

    Examples
    --------
    >>> from agglo_core import samples
    >>> whole = DistributedMesh.scatter(samples.squares(4))  # on rank 0 of several; None on the others
    >>> whole
    DistributedMesh(16 cells; rank 0 of 1: 16 own, 0 ghosts)
    >>> whole.h
    0.3535533905932738
    """

    ranks: Ranks
    local: Mesh
    global_ids: Int
    owners: Int
    point_ids: Int
    face_ids: Int
    hidden: Mask
    n_cells: int

    @classmethod
    def scatter(cls, mesh: Mesh | None, ranks: Ranks | None = None, method: str = "curve") -> DistributedMesh:
        """Share out a mesh that rank 0 has; global ids are its numbers of cells, faces and points.

        Parameters
        ----------
        mesh : Mesh or None
            On rank 0; what other ranks give is not looked at.
        ranks : Ranks, optional
            By default those of ``MPI.COMM_WORLD``.
        method : str
            ``"curve"``: stretches of a space-filling curve; ``"coordinates"``: boxes, halved recursively.

        Raises
        ------
        OptionError
            If rank 0 has no mesh, for an unknown method, or without mpi4py.

        Examples
        --------
        >>> from agglo_core import samples
        >>> DistributedMesh.scatter(samples.boxes(2), method="coordinates")
        DistributedMesh(8 cells; rank 0 of 1: 8 own, 0 ghosts)
        """
        ranks = ranks or Ranks()
        name = ranks.from_first(mesh.name if mesh is not None and ranks.rank == 0 else "")
        return cls._with_ghosts(ranks, scattered(mesh, ranks, method), name)

    @classmethod
    def _with_ghosts(cls, ranks: Ranks, own: WholeCells, name: str) -> DistributedMesh:
        whole = joined([own, *ghosts(own, ranks)])
        origin = common_origin(own, ranks)
        n_cells = sum(ranks.gathered(len(own.cells)))
        with ranks.together():
            mesh, hidden = local_mesh(whole, origin, name)
            return cls(ranks, mesh, whole.cells, whole.owners, whole.points, whole.faces, hidden, n_cells)

    def __repr__(self) -> str:
        rank, own = self.ranks, len(self.own)
        told = f"rank {rank.rank} of {rank.size}: {own} own, {len(self.owners) - own} ghosts"
        return f"DistributedMesh({self.n_cells} cells; {told})"

    @cached_property
    def own(self) -> Int:
        """Places of the own cells in the local mesh ``(n_own,)``, rising."""
        return frozen_int(np.flatnonzero(self.owners == self.ranks.rank))

    @cached_property
    def h(self) -> float:
        """Mesh size: the largest diameter of a cell of the whole mesh. All ranks must ask for it."""
        return self.ranks.largest(float(self.local.cell_diameters[self.own].max(initial=0.0)))

    @cached_property
    def _sent(self) -> dict[int, Int]:
        """Own cells (as numbers among the own ones) that are ghosts of each other rank."""
        sides = np.append(self.owners, -1)[self.local.face_cells]
        here = self.ranks.rank
        face, side = np.nonzero((sides == here) & (sides[:, ::-1] != here) & (sides[:, ::-1] >= 0))
        to, cell = sides[face, 1 - side], self.local.face_cells[face, side]
        return {
            int(rank): frozen_int(np.searchsorted(self.own, np.unique(cell[to == rank])))
            for rank in np.unique(to)
        }

    # -- other cells, other ranks ---------------------------------------------------------------
    def coarsen(self, labels: ArrayLike, bounds: ArrayLike) -> DistributedMesh:
        """Mesh whose cells are the agglomerates of this one's.

        Points and faces keep their numbers, points that no face needs any more are left out. A cell tag
        survives if it is the same on all cells of every part; face tags survive.

        Parameters
        ----------
        labels : (n_own,) int
            Part of each own cell, whichever rank is to have it: its global id in the coarse mesh.
        bounds : (size + 1,) int
            Rank r gets the parts ``bounds[r]:bounds[r + 1]``; the same on all ranks.

        Raises
        ------
        MeshError
            Unless the bounds rise from 0 and each part below the last one has a cell; on other ranks
            RankError.

        Examples
        --------
        >>> from agglo_core import samples
        >>> whole = DistributedMesh.scatter(samples.squares(4))
        >>> whole.coarsen([0, 0, 1, 1] * 4, [0, 2]).local
        Mesh('squares 4x4', 2-D, 2 cells, 20 faces, 20 points)
        """
        ends, size = np.asarray(bounds), self.ranks.size
        own, first_bounds = self._checked(labels), self.ranks.from_first(ends.tolist())
        with self.ranks.together():
            if (
                ends.shape != (size + 1,)
                or ends.dtype.kind not in "iu"
                or ends[0]
                or (np.diff(ends) < 0).any()
            ):
                raise MeshError(f"bounds must be {size + 1} integers that rise from 0, given {ends.tolist()}")
            if first_bounds != ends.tolist():
                raise MeshError(
                    f"bounds differ: {first_bounds} on rank 0, {ends.tolist()} on rank {self.ranks.rank}"
                )
            if own.ndim != 1 or (own.size and own.dtype.kind not in "iu"):
                raise MeshError(f"labels must be integers, one per own cell; given {own.dtype}, {own.shape}")
            wrong = np.flatnonzero((own < 0) | (own >= ends[-1]))
            if len(wrong):
                cell = self.global_ids[self.own[wrong[0]]]
                raise MeshError(f"cell {cell} has label {own[wrong[0]]}, but there are {ends[-1]} parts")
        number = self.exchange(frozen_int(own))
        coarse = self._moved(number, frozen_int(np.searchsorted(ends, number, side="right") - 1))
        with self.ranks.together():
            first, last = ends[self.ranks.rank : self.ranks.rank + 2]
            missing = np.setdiff1d(np.arange(first, last), coarse.global_ids[coarse.own])
            if len(missing):
                raise MeshError(f"labels leave gaps: no cell is labelled {missing[0]} (of 0..{ends[-1] - 1})")
        return coarse

    def redistributed(self, rank_of_own_cell: ArrayLike) -> DistributedMesh:
        """This mesh with each own cell on the rank given ``(n_own,)``; all numbers stay.

        Raises
        ------
        MeshError
            For a rank that does not exist; on other ranks RankError.

        Examples
        --------
        >>> from agglo_core import samples
        >>> DistributedMesh.scatter(samples.squares(2)).redistributed([0, 0, 0, 0])
        DistributedMesh(4 cells; rank 0 of 1: 4 own, 0 ghosts)
        """
        to = self._checked(rank_of_own_cell)
        with self.ranks.together():
            if to.ndim != 1 or (to.size and to.dtype.kind not in "iu"):
                raise MeshError(f"ranks must be integers, one per own cell; given {to.dtype}, {to.shape}")
            if to.min(initial=0) < 0 or to.max(initial=0) >= self.ranks.size:
                raise MeshError(
                    f"there are {self.ranks.size} ranks, but cells shall go to {to.min()}..{to.max()}"
                )
        return self._moved(self.global_ids, self.exchange(frozen_int(to)))

    def _moved(self, number: Int, to: Int) -> DistributedMesh:
        whole = moved(self._own_cells(), self.global_ids, number, to, self.ranks)
        return DistributedMesh._with_ghosts(self.ranks, whole, self.local.name)

    def _own_cells(self) -> WholeCells:
        ids = self.global_ids, self.owners, self.point_ids, self.face_ids
        return own_cells(self.local, *ids, self.ranks.rank)

    # -- values of cells -----------------------------------------------------------------------
    def exchange(self, values: ArrayLike) -> NDArray[Any]:
        """Values of all local cells ``(n_local, …)``: ghosts get those of their owners.

        Parameters
        ----------
        values : (n_own, …)
            Of the own cells, by rising global id.

        Raises
        ------
        MeshError
            If there are not as many values as own cells; on other ranks RankError.

        Examples
        --------
        >>> from agglo_core import samples
        >>> whole = DistributedMesh.scatter(samples.squares(2))
        >>> whole.exchange([5, 6, 7, 8]).tolist()
        [5, 6, 7, 8]
        """
        own = self._checked(values)
        arrived = self.ranks.exchanged({rank: own[cells] for rank, cells in self._sent.items()})
        everything = np.empty((len(self.owners), *own.shape[1:]), own.dtype)
        everything[self.own] = own
        for rank, found in arrived.items():
            everything[self.owners == rank] = found
        return frozen(everything, everything.dtype)

    def gather(self, values: ArrayLike) -> NDArray[Any]:
        """Values of all cells of the mesh ``(n_cells, …)`` by global id, on every rank: for small meshes.

        Parameters
        ----------
        values : (n_own, …)
            Of the own cells, by rising global id.

        Raises
        ------
        MeshError
            If there are not as many values as own cells; on other ranks RankError.

        Examples
        --------
        >>> from agglo_core import samples
        >>> DistributedMesh.scatter(samples.squares(2)).gather([5, 6, 7, 8]).tolist()
        [5, 6, 7, 8]
        """
        parts = self.ranks.gathered((self.global_ids[self.own], self._checked(values)))
        order = np.argsort(np.concatenate([ids for ids, _ in parts]))
        return np.concatenate([own for _, own in parts if len(own)])[order]

    def _checked(self, values: ArrayLike) -> NDArray[Any]:
        with self.ranks.together():
            array = np.asarray(values)
            if array.ndim == 0 or len(array) != len(self.own):
                rank, n = self.ranks.rank, len(self.own)
                raise MeshError(f"rank {rank} has {n} own cells, but the values have shape {array.shape}")
            return array
