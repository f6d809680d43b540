"""Writing a solution whose cells lie on several ranks: one piece for each, one list of the pieces."""

from __future__ import annotations

import logging
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, frozen_int
from agglo_core.distributed.files.own_pieces import remove_pieces, write_agreed
from agglo_core.distributed.files.shared_staging import shared_staging
from agglo_core.distributed.files.writing import check_parallel_target
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.errors import OptionError
from agglo_core.io.tags import check_names
from agglo_core.io.vtk.solution import solution_piece
from agglo_core.problems import Discretisation, Samples

_log = logging.getLogger("agglo")


def write_solution(
    path: str | PathLike[str], mesh: DistributedMesh, how: Discretisation, x: ArrayLike, *, name: str = "u"
) -> None:
    """Write a solution as ``.pvtu``, sampled in every cell as one process does; all ranks must call it.

    Each rank writes its own cells to ``NAME/NAME_<rank>.vtu``, rank 0 the list ``NAME.pvtu``, which ParaView
    opens. No two cells share points. Cell data are the cell tags and ``cell``, the global id. Files appear
    whole or not at all, the list last.

    Parameters
    ----------
    path : path
        The same on all ranks, in a folder that all of them see.
    mesh : DistributedMesh
    how : Discretisation
        What the unknowns mean.
    x : (n_own unknowns,) float
        Unknowns of the own cells, by rising global id; as many in each.
    name : str
        Of the function.

    Raises
    ------
    OptionError
        For another suffix, or numbers of unknowns that do not fit the own cells.
    FileError
        If a file cannot be written. What fails on one rank fails on all, there with a RankError.
    MeshError
        For a cell tag whose name files cannot hold.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.distributed import DistributedMesh, write_solution
    >>> squares = agglo.samples.squares(2)
    >>> how = agglo.registry.default().build("discretisation", "polydg", degree=1)
    >>> mesh = DistributedMesh.scatter(squares)
    >>> write_solution("u.pvtu", mesh, how, how.project(squares, 3.0))
    >>> sorted(set(agglo.read("u.pvtu").cell_tags["cell"].tolist()))
    [0, 1, 2, 3]
    """
    ranks, target = mesh.ranks, Path(path)
    with ranks.together():
        check_parallel_target(target)
        check_names(mesh.local.cell_tags)
    # ghosts are there when cells are cut up, as in one process: what sides of a cell go on straight is seen
    # with both of its neighbours
    everything = mesh.exchange(by_cell(mesh, x))
    with ranks.together():
        samples = _of_own_cells(how.sample(mesh.local, everything.ravel()), mesh)
        piece = solution_piece(samples, mesh.local.cell_tags, name=name, cell_ids=mesh.global_ids)
    with shared_staging(target, ranks) as folder:
        write_agreed(folder, target.stem, piece, ranks)
    with ranks.together():
        if ranks.rank == 0:
            _remove_stale(target, ranks.size)


def by_cell(mesh: DistributedMesh, x: ArrayLike) -> Float:
    """Unknowns of own cells ``(n_own, width)``, a row for each, or OptionError; all ranks must call it."""
    ranks, cells = mesh.ranks, len(mesh.own)
    with ranks.together():
        own = np.asarray(x, float)
    width = int(ranks.largest(own.size // max(1, cells)))
    with ranks.together():
        if own.shape != (cells * width,):
            raise OptionError(f"x has shape {own.shape}; expected ({cells * width},): {width} in each cell")
    return own.reshape(cells, width)


def _of_own_cells(samples: Samples, mesh: DistributedMesh) -> Samples:
    """The samples without those of ghosts."""
    kept = (mesh.owners == mesh.ranks.rank)[samples.cells]
    number = np.cumsum(kept) - 1
    simplices = samples.simplices[kept[samples.simplices[:, 0]]]
    return replace(
        samples,
        cells=frozen_int(samples.cells[kept]),
        points=samples.points[kept],
        simplices=frozen_int(number[simplices]),
        values=samples.values[kept],
    )


def _remove_stale(target: Path, size: int) -> None:
    """Remove pieces of more ranks that an earlier writing left."""
    try:
        remove_pieces(target.with_suffix(""), size)
    except OSError as error:  # the solution is written: this is not a reason to fail
        _log.warning("cannot remove what an earlier writing left of %s: %s", target, error.strerror)
