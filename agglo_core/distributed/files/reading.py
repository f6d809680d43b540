"""Reader for distributed meshes: VTK pieces on all ranks, other files on rank 0."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from agglo_core.arrays import Int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.files.pieces_read import mesh_of_pieces
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.errors import FileError
from agglo_core.files.regular import file_bytes
from agglo_core.io import read as read_whole
from agglo_core.io.file_checks import name_in_errors
from agglo_core.io.vtk.pvtu import join_contents, read_piece, sources_of
from agglo_core.registry import Registry


def read(
    path: str | PathLike[str],
    ranks: Ranks | None = None,
    *,
    allow_gaps: bool = False,
    registry: Registry | None = None,
) -> DistributedMesh:
    """Read a distributed mesh from a file. Collective, with equal arguments on all ranks.

    Consecutive pieces of a ``.pvtu`` are assigned to the ranks with balanced bytes: a rank may get several
    pieces, or none. Points are identified by global id if all pieces have ids, else by exact coordinates.
    Without ids, hanging vertices on faces of other cells are inserted across all ranks, as by
    :meth:`agglo_core.Mesh.conforming`. Cells are numbered as in :func:`agglo_core.read`: by global id in
    files of :func:`write`, else piece by piece. Rank 0 reads files of other formats and distributes them by
    coordinates (:meth:`DistributedMesh.scatter`).

    Parameters
    ----------
    path : path
    ranks : Ranks, optional
        Default: all ranks in ``MPI.COMM_WORLD``.
    allow_gaps : bool
        Leave outer faces apart that lie on each other. By default they are joined, as in
        :func:`agglo_core.read`, and pieces with global point ids and such faces are refused.
    registry : Registry, optional
        Format registry. Default: the installed plugins.

    Raises
    ------
    FileError, MeshError
        As :func:`agglo_core.read`, with the piece (RankError on other ranks).

    Examples
    --------
    >>> from agglo_core import distributed, samples, write
    >>> write("squares.vtu", samples.squares(4))
    >>> distributed.read("squares.vtu").n_cells
    16
    """
    ranks = ranks or Ranks()
    with ranks.together():
        file = Path(path)
        pieces = file.suffix.lower() == ".pvtu"
        whole = None
        if ranks.rank == 0 and not pieces:
            whole = read_whole(file, allow_gaps=allow_gaps, registry=registry)
    if not pieces:
        return DistributedMesh.scatter(whole, ranks)
    with ranks.together(), name_in_errors(file):
        shares = _share_pieces(file, ranks.size) if ranks.rank == 0 else []
    own = ranks.from_first(shares)[ranks.rank]
    with ranks.together(), name_in_errors(file):
        stored = join_contents([read_piece(file.parent, source) for source in own])
    return mesh_of_pieces(stored, file, ranks, allow_gaps=allow_gaps)


def _share_pieces(file: Path, size: int) -> list[list[str]]:
    """Distribute a file's VTK pieces to the ranks, balanced by file size."""
    sources = sources_of(file_bytes(file))
    if not sources:
        raise FileError("it contains no Piece")
    rank = _ranks_of([_bytes(file.parent / source) for source in sources], size)
    return [[sources[i] for i in np.flatnonzero(rank == each)] for each in range(size)]


def _ranks_of(weights: Sequence[int], size: int) -> Int:
    """Assign successive weights to ranks in increasing order, with balanced sums."""
    ends = np.cumsum(weights, dtype=np.float64)
    middles = ends - 0.5 * np.asarray(weights)
    return np.asarray(np.minimum(size * middles / max(ends[-1], 1.0), size - 1), np.int64)


def _bytes(piece: Path) -> int:
    return piece.stat().st_size if piece.is_file() else 0
