"""Cell values across ranks: on the cells of this rank, on ghosts, on all cells."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Int, frozen, frozen_int, plain_array
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.whole_cells import distinct
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh


class CellValues:
    """Base of :class:`~agglo_core.distributed.DistributedMesh`: exchange of cell values between ranks."""

    ranks: Ranks
    local: Mesh
    global_ids: Int
    owners: Int

    @cached_property
    def own(self) -> Int:
        """Local indices of this rank's own cells ``(n_own,)``, increasing."""
        return frozen_int(np.flatnonzero(self.owners == self.ranks.rank))

    @cached_property
    def h(self) -> float:
        """Mesh size: largest cell diameter of the whole mesh. Collective."""
        return self.ranks.largest(float(self.local.cell_diameters[self.own].max(initial=0.0)))

    @cached_property
    def ghosts_elsewhere(self) -> dict[int, Int]:
        """This rank's cells that are ghosts on each other rank: indices among the own cells, increasing."""
        sides = np.append(self.owners, -1)[self.local.face_cells]
        here = self.ranks.rank
        face, side = np.nonzero((sides == here) & (sides[:, ::-1] != here) & (sides[:, ::-1] >= 0))
        to, cell = sides[face, 1 - side], self.local.face_cells[face, side]
        return {
            int(rank): frozen_int(np.searchsorted(self.own, distinct(cell[to == rank])))
            for rank in distinct(to)
        }

    def exchange(self, values: ArrayLike) -> NDArray[Any]:
        """Extend values on this rank's cells to its ghosts, with ghost values from their owners.

        Parameters
        ----------
        values : (n_own, …)
            Values on own cells, by increasing global id.

        Raises
        ------
        MeshError
            If the number of values differs from the number of own cells (RankError on other ranks), or
            value shapes differ between ranks (on all ranks).

        Examples
        --------
        >>> from agglo_core import samples
        >>> from agglo_core.distributed import DistributedMesh
        >>> whole = DistributedMesh.scatter(samples.squares(2))
        >>> whole.exchange([5, 6, 7, 8]).tolist()
        [5, 6, 7, 8]
        """
        array = self.checked(values)
        arrived = self.ranks.exchanged({rank: array[cells] for rank, cells in self.ghosts_elsewhere.items()})
        everything = np.empty((len(self.owners), *array.shape[1:]), array.dtype)
        everything[self.own] = array
        for rank, ghost_values in arrived.items():
            everything[self.owners == rank] = ghost_values
        return frozen(everything, everything.dtype)

    def gather(self, values: ArrayLike) -> NDArray[Any]:
        """Collect the values on all cells ``(n_cells, …)`` by global id on every rank, for small meshes.

        Parameters
        ----------
        values : (n_own, …)
            Values on own cells, by increasing global id.

        Raises
        ------
        MeshError
            If the number of values differs from the number of own cells (RankError on other ranks), or
            value shapes differ between ranks (on all ranks).

        Examples
        --------
        >>> from agglo_core import samples
        >>> from agglo_core.distributed import DistributedMesh
        >>> DistributedMesh.scatter(samples.squares(2)).gather([5, 6, 7, 8]).tolist()
        [5, 6, 7, 8]
        """
        parts = self.ranks.gathered((self.global_ids[self.own], self.checked(values)))
        order = np.argsort(np.concatenate([ids for ids, _ in parts]))
        return np.concatenate([own for _, own in parts])[order]

    def checked(self, values: ArrayLike) -> NDArray[Any]:
        """Return values on this rank's cells as an array, and check that all ranks' arrays match.

        Raises
        ------
        MeshError
            If the number of values differs from the number of own cells (RankError on other ranks), or
            value shapes differ between ranks (on all ranks).
        """
        rank_id, n = self.ranks.rank, len(self.own)
        with self.ranks.together():
            array = plain_array(values, f"rank {rank_id}: values")
            if array.ndim == 0 or len(array) != n:
                raise MeshError(f"rank {rank_id} has {n} own cells, but the values have shape {array.shape}")
        kinds = self.ranks.gathered((array.shape[1:], array.dtype) if n else None)
        kinds_by_rank = [(rank, *kind) for rank, kind in enumerate(kinds) if kind is not None]
        first, shape, _ = kinds_by_rank[0]
        for rank, other_shape, _ in kinds_by_rank:
            if other_shape != shape:
                raise MeshError(
                    f"values per cell have shape {shape} on rank {first}, {other_shape} on rank {rank}"
                )
        dtype = np.result_type(*(kind for _, _, kind in kinds_by_rank))
        return array.astype(dtype, copy=False) if n else np.empty((0, *shape), dtype)
