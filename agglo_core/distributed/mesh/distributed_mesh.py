"""DistributedMesh: mesh distributed across MPI ranks, with one layer of ghosts per rank."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Int, Mask, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.cell_values import CellValues
from agglo_core.distributed.mesh.checks import check_laws
from agglo_core.distributed.mesh.given_cells import check_given_cells
from agglo_core.distributed.mesh.halo import LocalMesh, common_origin, ghosts, local_mesh, own_cells
from agglo_core.distributed.mesh.local_cells import FaceTags, across_ranks
from agglo_core.distributed.mesh.moving import check_bounds, check_destinations, move_cells
from agglo_core.distributed.mesh.sharing import scatter_cells
from agglo_core.distributed.mesh.touching_ranks import refuse_hanging_vertices
from agglo_core.distributed.mesh.whole_cells import WholeCells, merge_cells
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import whole_numbers


@dataclass(frozen=True, eq=False)
class DistributedMesh(CellValues):
    """Mesh distributed across MPI ranks: each rank holds its own cells, and their neighbours as ghosts.

    Build a mesh with :meth:`scatter`, :meth:`from_local` or :meth:`from_pieces`. These and all other methods
    are collective: all ranks must call them. Results for own cells (measures, centroids, interfaces) do not
    depend on the number of ranks, bit for bit, because local cells, faces and points are in global order and
    ``origin`` is that of the whole mesh. Results for ghosts may differ by rounding. :meth:`exchange` fetches
    the owners' values. A rank may have no cells, and then an empty local mesh.

    Attributes
    ----------
    ranks : Ranks
    local : Mesh
        Own cells and ghosts by global id. Ghosts are all cells of other ranks that share a face with an
        own cell.
    global_ids : (local.n_cells,) int
        Global cell ids, increasing.
    owners : (local.n_cells,) int
        Owner per cell.
    point_ids : (local.n_points,) int
        Global point ids, increasing.
    face_ids : (local.n_faces,) int
        Global face numbers, increasing. Some numbers may be unused.
    hidden : (local.n_faces,) bool
        Ghost faces to cells outside the local mesh. They look like boundary faces, but have no tags.
    n_cells : int
        Number of cells of the whole mesh.

    Examples
    --------
    >>> from agglo_core import samples
    >>> whole = DistributedMesh.scatter(samples.squares(4))  # on rank 0 of several; None on the others
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
    def scatter(
        cls,
        mesh: Mesh | None,
        ranks: Ranks | None = None,
        method: str = "coordinates",
        *,
        block_cells: int | None = None,
    ) -> DistributedMesh:
        """Distribute a mesh from rank 0. Global ids are its cell, face and point indices.

        Parameters
        ----------
        mesh : Mesh or None
            Mesh on rank 0. Ignored on other ranks.
        ranks : Ranks, optional
            Default: the ranks of ``MPI.COMM_WORLD``.
        method : str
            ``"coordinates"``: whole blocks, so that :func:`agglomerate` makes equal parts on any number
            of ranks, or boxes if a rank would get more than 1.6 times the mean. ``"curve"``: intervals of
            a space-filling curve.
        block_cells : int, optional
            Approximate maximum number of cells per block, as for :func:`agglomerate`. Default: 16,384 in
            2-D, 131,072 in 3-D.

        Raises
        ------
        OptionError
            If rank 0 has no mesh, for an unknown method or blocks without cells, or without mpi4py.

        Examples
        --------
        >>> from agglo_core import samples
        >>> DistributedMesh.scatter(samples.boxes(2), method="curve")
        DistributedMesh(8 cells; rank 0 of 1: 8 own, 0 ghosts)
        """
        ranks = ranks or Ranks()
        name = ranks.from_first(mesh.name if mesh is not None and ranks.rank == 0 else "")
        return cls._with_ghosts(ranks, scatter_cells(mesh, ranks, method, block_cells), name)

    @classmethod
    def from_local(
        cls,
        ranks: Ranks | None,
        points: ArrayLike,
        cells: Any,
        point_ids: ArrayLike,
        *,
        cell_ids: ArrayLike | None = None,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        face_tags: FaceTags | None = None,
        weak: bool = False,
        allow_gaps: bool = False,
        name: str = "",
    ) -> DistributedMesh:
        """Build a mesh from the cells that each rank has, and find neighbours by their face points.

        Parameters
        ----------
        ranks : Ranks or None
            None for all ranks of ``MPI.COMM_WORLD``.
        points : (n_points, d) float
            Points of the cells, possibly with unused points. A rank without cells may pass anything.
        cells
            Own cells by local point numbers, as in :meth:`Mesh.from_polygons` or, if d is 3,
            :meth:`Mesh.from_polyhedra`.
        point_ids : (n_points,) int
            Global ids. Points with equal id are identified across ranks and must coincide.
        cell_ids : (n_own,) int, optional
            Global ids, a permutation of 0..n_cells−1 over all ranks. Default: numbered rank after rank.
        cell_tags : mapping of name to (n_own,) int, optional
            Equal names on all ranks with cells.
        face_tags : mapping of name to (faces, values), optional
            Faces as point lists with an integer each, 0 elsewhere. Either rank may tag a face between ranks.
        weak : bool
            As in :meth:`Mesh.from_polygons`: 2-D cells may have bridges to holes.
        allow_gaps : bool
            Keep outer faces apart that lie on each other, as at fractures. By default, outer faces that
            lie on each other are refused if they share points, as at hanging vertices, and reported by a
            warning otherwise. Unlike :meth:`Mesh.conforming`, nothing is joined.
        name : str

        Raises
        ------
        MeshError
            For an invalid cell, with its local number (RankError on other ranks). On all ranks, with
            ranks and cells: for duplicate or missing cell ids, a point at two places, three cells at a
            face, cells of two ranks on one side of a face, ranks with different dimensions or tag names,
            a mesh without cells, or faces refused under ``allow_gaps``.

        Examples
        --------
        >>> points = [[0, 0], [1, 0], [1, 1], [0, 1]]
        >>> whole = DistributedMesh.from_local(None, points, [[0, 1, 2], [0, 2, 3]], [7, 9, 4, 2])
        >>> whole.local.n_faces, whole.point_ids.tolist()
        (5, [2, 4, 7, 9])
        """
        ranks = ranks or Ranks()
        with ranks.together():
            ids = whole_numbers(point_ids, "point_ids")
        given = check_given_cells(points, cells, ids, cell_ids, cell_tags, ranks, weak=weak, name=name)
        return cls._given(ranks, across_ranks(given, face_tags, ranks), allow_gaps, name)

    @classmethod
    def from_pieces(
        cls,
        ranks: Ranks | None,
        points: ArrayLike,
        cells: Any,
        *,
        cell_ids: ArrayLike | None = None,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        face_tags: FaceTags | None = None,
        weak: bool = False,
        allow_gaps: bool = False,
        name: str = "",
    ) -> DistributedMesh:
        """Build a mesh as :meth:`from_local`, but recognise common points by exactly equal coordinates.

        Examples
        --------
        >>> points = [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]
        >>> DistributedMesh.from_pieces(None, points, [[0, 1, 2], [3, 4, 5]]).local.n_points
        4
        """
        ranks = ranks or Ranks()
        given = check_given_cells(points, cells, None, cell_ids, cell_tags, ranks, weak=weak, name=name)
        return cls._given(ranks, across_ranks(given, face_tags, ranks), allow_gaps, name)

    @classmethod
    def _given(cls, ranks: Ranks, own_cells: WholeCells, allow_gaps: bool, name: str) -> DistributedMesh:
        if not allow_gaps:
            refuse_hanging_vertices(own_cells, ranks)
        return cls._with_ghosts(ranks, own_cells, name)

    @classmethod
    def _with_ghosts(cls, ranks: Ranks, own_cells: WholeCells, name: str) -> DistributedMesh:
        whole = merge_cells([own_cells, *ghosts(own_cells, ranks)])
        origin = common_origin(own_cells, ranks)
        n_cells = sum(ranks.gathered(len(own_cells.cells)))
        with ranks.together():
            mesh, hidden = local_mesh(whole, origin, name)
            return cls(ranks, mesh, whole.cells, whole.owners, whole.points, whole.faces, hidden, n_cells)

    def __repr__(self) -> str:
        rank, own = self.ranks, len(self.own)
        counts = f"{own} own, {len(self.owners) - own} ghosts"
        return f"DistributedMesh({self.n_cells} cells; rank {rank.rank} of {rank.size}: {counts})"

    def check(self) -> None:
        """Check that each cell has one owner, and that ghosts are complete and equal to the owners' cells.

        Raises
        ------
        MeshError
            On all ranks, naming rank and cell.

        Examples
        --------
        >>> from agglo_core import samples
        >>> DistributedMesh.scatter(samples.squares(2)).check()
        """
        held = LocalMesh(self.local, self.hidden)
        check_laws(self._own_cells(), self.global_ids, self.owners, held, self.n_cells, self.ranks)

    def coarsen(self, labels: ArrayLike, bounds: ArrayLike) -> DistributedMesh:
        """Return the coarse mesh, whose cells are the agglomerates.

        Points and faces keep their numbers, and unused points are dropped. A cell tag survives if constant on
        every part. Face tags survive.

        Parameters
        ----------
        labels : (n_own,) int
            Part per own cell: its global id in the coarse mesh, on any rank.
        bounds : (size + 1,) int
            Rank r gets the parts ``bounds[r]:bounds[r + 1]``. Equal on all ranks.

        Raises
        ------
        MeshError
            If the bounds do not increase from 0, or a part has no cell (RankError on other ranks).

        Examples
        --------
        >>> from agglo_core import samples
        >>> whole = DistributedMesh.scatter(samples.squares(4))
        >>> whole.coarsen([0, 0, 1, 1] * 4, [0, 2]).local
        Mesh('squares 4x4', 2-D, 2 cells, 20 faces, 19 points)
        """
        # Exchange the part numbers of ghosts, and send each part to its rank.
        ends, own = np.asarray(bounds), self.checked(labels)
        check_bounds(own, ends, self.global_ids[self.own], self.ranks)
        number = self.exchange(frozen_int(own))
        coarse = self._moved(number, frozen_int(np.searchsorted(ends, number, side="right") - 1))
        with self.ranks.together():
            first, last = ends[self.ranks.rank : self.ranks.rank + 2]
            if last - first > len(coarse.own):
                missing = np.setdiff1d(np.arange(first, last), coarse.global_ids[coarse.own])[0]
                raise MeshError(f"labels have gaps: no cell has label {missing} (of 0..{ends[-1] - 1})")
        return coarse

    def redistributed(self, rank_of_own_cell: ArrayLike) -> DistributedMesh:
        """Return the mesh with each cell moved to a given rank ``(n_own,)``. Global ids are unchanged.

        Raises
        ------
        MeshError
            For a rank that does not exist (RankError on other ranks).

        Examples
        --------
        >>> from agglo_core import samples
        >>> DistributedMesh.scatter(samples.squares(2)).redistributed([0, 0, 0, 0])
        DistributedMesh(4 cells; rank 0 of 1: 4 own, 0 ghosts)
        """
        to = self.checked(rank_of_own_cell)
        check_destinations(to, self.global_ids[self.own], self.ranks)
        return self._moved(self.global_ids, self.exchange(frozen_int(to)))

    def _moved(self, number: Int, to: Int) -> DistributedMesh:
        whole = move_cells(self._own_cells(), self.global_ids, number, to, self.ranks)
        return DistributedMesh._with_ghosts(self.ranks, whole, self.local.name)

    def _own_cells(self) -> WholeCells:
        ids = self.global_ids, self.owners, self.point_ids, self.face_ids
        return own_cells(self.local, *ids, self.ranks.rank)
