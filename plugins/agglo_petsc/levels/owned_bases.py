"""Tentative prolongations on aggregates distributed over ranks, computed by each aggregate's owner.

Near-null rows are sent to their aggregate's owner, prolongation rows back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, frozen_float, frozen_int
from agglo_core.multigrid.coarsening.prolongation import tentative
from agglo_petsc.messages import agree, exchange_parcels


@dataclass(frozen=True, eq=False)
class OwnedBases:
    """A tentative (unsmoothed) prolongation with rows and columns distributed over ranks.

    Attributes
    ----------
    rows : (n_own, m) csr
        Rows of this rank, global columns.
    offsets : (owned aggregates + 1,) int
        Coarse unknowns per aggregate on this rank.
    near_null : (owned columns, k) float
        The near-null vectors on the coarse level.
    """

    rows: Any
    offsets: Int
    near_null: Float


def bases_where_owned(comm: Any, holder: Any, count: int, near_null: Float) -> OwnedBases:
    """Compute a tentative prolongation by restriction of near-null vectors to aggregates. Collective.

    Parameters
    ----------
    comm : petsc4py.PETSc.Comm
    holder : (n_own,) int
        Global aggregate per unknown, −1 for none.
    count : int
        Aggregate count on this rank; numbers continue from rank to rank.
    near_null : (n_own, k) float

    Raises
    ------
    OptionError
        On all ranks, if an aggregate has no unknowns.
    """
    # 1. Send the rows to the owners of their aggregates
    ranks = comm.tompi4py()
    starts = np.concatenate(([0], np.cumsum(ranks.allgather(count))))
    owner = np.where(holder < 0, -1, np.searchsorted(starts, holder, side="right") - 1)
    sent_rows = {rank: np.flatnonzero(owner == rank) for rank in np.unique(owner[owner >= 0]).tolist()}
    arrived = exchange_parcels(
        ranks, {rank: (holder[rows], near_null[rows]) for rank, rows in sent_rows.items()}
    )
    # 2. Check that no aggregate is empty, and compute the bases
    first = int(starts[ranks.rank])
    ids = np.concatenate([np.empty(0, np.int64), *(item[0] for item in arrived.values())]) - first
    values = np.concatenate([np.empty((0, near_null.shape[1])), *(item[1] for item in arrived.values())])
    empty = np.flatnonzero(np.bincount(ids, minlength=count) == 0)
    agree(comm, f"aggregate {first + empty[0]} has no part" if len(empty) else "")
    bases = tentative(frozen_int(ids), count, frozen_float(values))
    # 3. Return the rows of the prolongation
    before = int(sum(ranks.allgather(bases.T.shape[1])[: ranks.rank]))
    total = int(ranks.allreduce(bases.T.shape[1]))
    answers, at = {}, 0
    for rank, (rank_ids, _) in arrived.items():
        piece = bases.T[at : at + len(rank_ids)]
        answers[rank] = np.diff(piece.indptr), piece.indices + before, piece.data
        at += len(rank_ids)
    return OwnedBases(
        _rows(exchange_parcels(ranks, answers), sent_rows, len(holder), total), bases.offsets, bases.near_null
    )


def _rows(answers: Any, sent_rows: Any, n: int, total: int) -> Any:
    """Assemble prolongation rows, received from the aggregate owners, into a matrix."""
    places = [np.repeat(sent_rows[rank], counts) for rank, (counts, _, _) in answers.items()]
    rows, columns, data = (
        np.concatenate([np.empty(0, kind), *arrays])
        for kind, arrays in (
            (np.int64, places),
            (np.int64, [arrays[1] for arrays in answers.values()]),
            (np.float64, [arrays[2] for arrays in answers.values()]),
        )
    )
    return sparse.csr_array((data, (rows, columns)), shape=(n, total))
