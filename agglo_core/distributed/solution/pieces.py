"""Writer for distributed solutions: one VTK piece per rank and a list of the pieces."""

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
    """Write a solution as ``.pvtu``, sampled in each cell at the same points as serially. Collective.

    Each rank writes its own cells to ``NAME/NAME_<rank>.vtu``, rank 0 the list ``NAME.pvtu`` for ParaView.
    No two cells share points. Cell data are the cell tags and ``cell``, the global id. Files appear whole or
    not at all, the list last.

    Parameters
    ----------
    path : path
        Equal on all ranks, in a shared folder.
    mesh : DistributedMesh
    how : Discretisation
        Interpretation of the unknowns.
    x : (n_own unknowns,) float
        Unknowns on own cells by increasing global id, equally many per cell.
    name : str
        Function name.

    Raises
    ------
    OptionError
        For another suffix, or a number of unknowns that does not fit the own cells.
    FileError
        If a file cannot be written. A failure on one rank is a failure on all ranks, with a RankError on
        the others.
    MeshError
        For a cell tag with a name that files cannot hold.

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
    # Sample with ghosts, as a single process does: a straight continuation of a cell's side is detected from
    # both neighbours.
    everything = mesh.exchange(by_cell(mesh, x))
    with ranks.together():
        samples = _of_own_cells(how.sample(mesh.local, everything.ravel()), mesh)
        piece = solution_piece(samples, mesh.local, name=name, cell_ids=mesh.global_ids)
    with shared_staging(target, ranks) as folder:
        write_agreed(folder, target.stem, piece, ranks)
    with ranks.together():
        if ranks.rank == 0:
            _remove_stale(target, ranks.size)


def by_cell(mesh: DistributedMesh, x: ArrayLike) -> Float:
    """Return the unknowns as one row per cell of this rank. A wrong shape raises OptionError. Collective."""
    ranks, cells = mesh.ranks, len(mesh.own)
    with ranks.together():
        unknowns = np.asarray(x, float)
    width = int(ranks.largest(unknowns.size // max(1, cells)))
    with ranks.together():
        if unknowns.shape != (cells * width,):
            raise OptionError(f"x has shape {unknowns.shape}; expected ({cells * width},): {width} per cell")
    return unknowns.reshape(cells, width)


def _of_own_cells(samples: Samples, mesh: DistributedMesh) -> Samples:
    """Return the samples on the cells owned by this rank."""
    is_own = (mesh.owners == mesh.ranks.rank)[samples.cells]
    number = np.cumsum(is_own) - 1
    kept = is_own[samples.simplices[:, 0]]
    gradients, stresses = (
        None if each is None else each[kept] for each in (samples.gradients, samples.stresses)
    )
    return replace(
        samples,
        cells=frozen_int(samples.cells[is_own]),
        points=samples.points[is_own],
        simplices=frozen_int(number[samples.simplices[kept]]),
        values=samples.values[is_own],
        gradients=gradients,
        stresses=stresses,
    )


def _remove_stale(target: Path, size: int) -> None:
    """Remove the files of an earlier run with more ranks."""
    try:
        remove_pieces(target.with_suffix(""), size)
    except OSError as error:  # the solution is complete, so only warn
        _log.warning("cannot remove old files of %s: %s", target, error.strerror)
