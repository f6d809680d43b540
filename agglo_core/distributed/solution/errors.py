"""Discretisation error norms of a distributed solution, from the cells of all ranks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.distributed.solution.pieces import by_cell
from agglo_core.distributed.solution.second_layer import with_second_layer
from agglo_core.problems import Discretisation, Problem


def error_norms(
    mesh: DistributedMesh, problem: Problem, how: Discretisation, x: ArrayLike
) -> dict[str, float]:
    """Compute discretisation error norms over all ranks, equal on every rank. Collective.

    Each rank contributes the squares on its own cells and half their faces.

    Parameters
    ----------
    mesh : DistributedMesh
    problem : Problem
        The problem as posed on the local cells.
    how : Discretisation
        Interpretation of the unknowns. Its ``errors_in`` measures part of a mesh.
    x : (n_own unknowns,) float
        Unknowns on own cells by increasing global id, equally many per cell.

    Returns
    -------
    dict
        Norms by name. Empty if a rank lacks the exact solution, or ``how`` lacks ``errors_in``.

    Raises
    ------
    OptionError
        If the number of unknowns does not fit the own cells, and errors of ``how``. A failure on one rank
        is a failure on all ranks, with a RankError on the others.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.distributed import DistributedMesh, error_norms
    >>> squares = agglo.samples.squares(2)
    >>> sine = agglo.problems.named_problem("sine", squares)
    >>> how = agglo.registry.default().build("discretisation", "polydg", degree=1)
    >>> x, mesh = how.project(squares, 0.0), DistributedMesh.scatter(squares)
    >>> round(error_norms(mesh, sine, how, x)["l2"], 6)  # ‖u‖ is 1/2
    0.5
    """
    ranks = mesh.ranks
    wide, ids = with_second_layer(mesh)  # where face penalties are as on the whole mesh
    values = mesh.exchange(by_cell(mesh, x))
    with ranks.together():
        everything = np.zeros((len(ids), values.shape[1]))
        everything[np.searchsorted(ids, mesh.global_ids)] = values
        is_own = np.isin(ids, mesh.global_ids[mesh.own])
        norms = _measure_errors(problem, wide, how, everything.ravel(), is_own) if is_own.any() else None
    rank_norms = [record for record in ranks.gathered(norms) if record is not None]
    names = [name for name in rank_norms[0] if all(name in record for record in rank_norms)]
    return {name: math.hypot(*(record[name] for record in rank_norms)) for name in names}


def _measure_errors(problem: Problem, wide: Any, how: Discretisation, x: Any, mine: Any) -> dict[str, float]:
    errors_in = getattr(how, "errors_in", None)
    return {} if errors_in is None else dict(errors_in(problem, wide, x, mine))
