"""DistributedMesh: a mesh whose cells lie on the ranks of MPI, each with one layer of ghosts."""

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
from agglo_core.distributed.mesh.given_cells import given_cells
from agglo_core.distributed.mesh.halo import LocalMesh, common_origin, ghosts, local_mesh, own_cells
from agglo_core.distributed.mesh.local_cells import FaceTags, across_ranks
from agglo_core.distributed.mesh.moving import check_bounds, check_destinations, moved
from agglo_core.distributed.mesh.sharing import scattered
from agglo_core.distributed.mesh.touching_ranks import refuse_hanging_vertices
from agglo_core.distributed.mesh.whole_cells import WholeCells, joined
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import whole_numbers


@dataclass(frozen=True, eq=False)
class DistributedMesh(CellValues):
    """A mesh whose cells lie on the ranks of MPI: each has its own cells, and their neighbours as ghosts.

    Build one with :meth:`scatter`, :meth:`from_local` or :meth:`from_pieces`. All ranks must call these, and
    all other methods, together. What is computed of own cells (measures, centroids, interfaces) does
    not depend on the number of ranks, not in the last bit: cells, faces and points of the local mesh are in
    the order of their global numbers, and its ``origin`` is that of the whole mesh. Of ghosts it may differ
    by rounding; :meth:`exchange` brings the values of their owners. A rank may have no cells: its local mesh
    has none then, and no faces and points.

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
        """Share out a mesh that rank 0 has; global ids are its numbers of cells, faces and points.

        Parameters
        ----------
        mesh : Mesh or None
            On rank 0; what other ranks give is not looked at.
        ranks : Ranks, optional
            By default those of ``MPI.COMM_WORLD``.
        method : str
            ``"coordinates"``: whole blocks, so that :func:`agglomerate` makes the same parts on any number of
            ranks; boxes if one had 1.6 times the mean. ``"curve"``: stretches of a space-filling curve.
        block_cells : int, optional
            How many cells make a block, at most about: 16,384, in space 131,072; as for :func:`agglomerate`.

        Raises
        ------
        OptionError
            If rank 0 has no mesh, for an unknown method or no cells in blocks, or without mpi4py.

        Examples
        --------
        >>> from agglo_core import samples
        >>> DistributedMesh.scatter(samples.boxes(2), method="curve")
        DistributedMesh(8 cells; rank 0 of 1: 8 own, 0 ghosts)
        """
        ranks = ranks or Ranks()
        name = ranks.from_first(mesh.name if mesh is not None and ranks.rank == 0 else "")
        return cls._with_ghosts(ranks, scattered(mesh, ranks, method, block_cells), name)

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
        """Mesh from the cells that each rank holds; neighbours on other ranks are found by their points.

        Parameters
        ----------
        ranks : Ranks or None
            None stands for all of ``MPI.COMM_WORLD``.
        points : (n_points, d) float
            Those that the cells use, and maybe others. A rank without cells may give anything.
        cells
            Own cells alone, with numbers of these points: as in :meth:`Mesh.from_polygons` or, if d is 3,
            :meth:`Mesh.from_polyhedra`.
        point_ids : (n_points,) int
            Global ids: points with the same one are one, on whichever ranks, and must be at one place.
        cell_ids : (n_own,) int, optional
            Global ids, all of 0..n_cells−1 in use; by default cells are numbered rank after rank.
        cell_tags : mapping of name to (n_own,) int, optional
            The same names on all ranks that have cells.
        face_tags : mapping of name to (faces, values), optional
            Faces as lists of points and an integer for each; others get 0. Between ranks either may say it.
        weak : bool
            As in :meth:`Mesh.from_polygons`: plane cells may have bridges to holes.
        allow_gaps : bool
            Whether outer faces that lie on one another are to be apart, as at fractures. Otherwise those
            with points in common, such as at vertices that hang on a face, are refused, others told by a
            warning. Unlike :meth:`Mesh.conforming` nothing is joined.
        name : str

        Raises
        ------
        MeshError
            For a cell that is faulty by itself, with its number on this rank (on other ranks RankError);
            on all ranks, naming ranks and cells: cell ids that are given twice or missing, a point at two
            places, three cells at a face, cells of two ranks that lie on the same side of a face, ranks
            that differ in dimension or names of tags, no cells at all, faces as said at ``allow_gaps``.

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
        given = given_cells(points, cells, ids, cell_ids, cell_tags, ranks, weak=weak, name=name)
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
        """As :meth:`from_local`, for points without global ids: those at exactly the same place are one.

        Examples
        --------
        >>> points = [[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]]
        >>> DistributedMesh.from_pieces(None, points, [[0, 1, 2], [3, 4, 5]]).local.n_points
        4
        """
        ranks = ranks or Ranks()
        given = given_cells(points, cells, None, cell_ids, cell_tags, ranks, weak=weak, name=name)
        return cls._given(ranks, across_ranks(given, face_tags, ranks), allow_gaps, name)

    @classmethod
    def _given(cls, ranks: Ranks, own: WholeCells, allow_gaps: bool, name: str) -> DistributedMesh:
        if not allow_gaps:
            refuse_hanging_vertices(own, ranks)
        return cls._with_ghosts(ranks, own, name)

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
        told = f"{own} own, {len(self.owners) - own} ghosts"
        return f"DistributedMesh({self.n_cells} cells; rank {rank.rank} of {rank.size}: {told})"

    def check(self) -> None:
        """See that each cell is owned once, and that each rank has all ghosts, as their owners have them.

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
            Unless the bounds rise from 0 and each part has a cell; on other ranks RankError.

        Examples
        --------
        >>> from agglo_core import samples
        >>> whole = DistributedMesh.scatter(samples.squares(4))
        >>> whole.coarsen([0, 0, 1, 1] * 4, [0, 2]).local
        Mesh('squares 4x4', 2-D, 2 cells, 20 faces, 19 points)
        """
        ends, own = np.asarray(bounds), self.checked(labels)
        check_bounds(own, ends, self.global_ids[self.own], self.ranks)
        number = self.exchange(frozen_int(own))
        coarse = self._moved(number, frozen_int(np.searchsorted(ends, number, side="right") - 1))
        with self.ranks.together():
            first, last = ends[self.ranks.rank : self.ranks.rank + 2]
            if last - first > len(coarse.own):
                missing = np.setdiff1d(np.arange(first, last), coarse.global_ids[coarse.own])[0]
                raise MeshError(f"labels leave gaps: no cell is labelled {missing} (of 0..{ends[-1] - 1})")
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
        to = self.checked(rank_of_own_cell)
        check_destinations(to, self.global_ids[self.own], self.ranks)
        return self._moved(self.global_ids, self.exchange(frozen_int(to)))

    def _moved(self, number: Int, to: Int) -> DistributedMesh:
        whole = moved(self._own_cells(), self.global_ids, number, to, self.ranks)
        return DistributedMesh._with_ghosts(self.ranks, whole, self.local.name)

    def _own_cells(self) -> WholeCells:
        ids = self.global_ids, self.owners, self.point_ids, self.face_ids
        return own_cells(self.local, *ids, self.ranks.rank)
