"""Prolongation by smoothed aggregation: near-null vectors on aggregates, and one Jacobi step on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, Mask, frozen, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.kernels.aggregates import couplings, local_bases, split_weak


class Couplings(NamedTuple):
    """How strongly the parts of a matrix are coupled: CSR over parts, and the size of diagonal blocks."""

    graph: Int
    to: Any
    weight: Float
    size: Float

    @classmethod
    def of(cls, A: Any, offsets: Int, part_of: Int) -> Couplings:
        """Those of a CSR whose part p is ``offsets[p]:offsets[p + 1]``."""
        found = couplings(A.indptr, A.indices, A.data, offsets, part_of)
        return cls(*(frozen(array, array.dtype) for array in found))

    @property
    def neighbours(self) -> float:
        """Mean number of neighbours."""
        return len(self.to) / max(len(self.size), 1)


@dataclass(frozen=True, eq=False)
class Tentative:
    """Near-null vectors B cut at the borders of aggregates: B = T ``near_null``.

    Attributes
    ----------
    T : (n, m) sparse
        Orthonormal columns.
    offsets : (aggregates + 1,) int
        The coarse unknowns of each aggregate.
    near_null : (m, k) float
        B on the coarse level.
    mask : (n, k) bool
        Which columns of their aggregate the rows of T have.
    holder : (n,) int
        Aggregate of each unknown; −1: none.
    R : (aggregates, k, k) float
        B in the basis of an aggregate.
    """

    T: Any
    offsets: Int
    near_null: Float
    mask: Mask
    holder: Int
    R: Float

    def of(self, values: Float) -> Any:
        """Return the matrix that is to ``values (n, k)`` what T is to B: the same combinations, cut alike."""
        single = self.R.shape[1] == 1
        back = 1.0 / np.where(self.R > 0.0, self.R, 1.0) if single else np.linalg.pinv(self.R)
        combined = np.einsum("ik,ikq->iq", values, back[self.holder])[self.mask]
        return sparse.csr_array((combined, self.T.indices, self.T.indptr), shape=self.T.shape)


def tentative(labels: Int, count: int, near_null: Float) -> Tentative:
    """Return the tentative prolongation of aggregates (Vaněk, Mandel, Brezina, Computing 56, 1996).

    Parameters
    ----------
    labels : (n,) int
        Aggregate of each unknown; −1: none.
    count : int
        Number of aggregates.
    near_null : (n, k) float

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.authoring import tentative
    >>> found = tentative(np.array([0, 0, 0, 0, 1]), 2, np.ones((5, 1)))
    >>> found.T.toarray()
    array([[0.5, 0. ],
           [0.5, 0. ],
           [0.5, 0. ],
           [0.5, 0. ],
           [0. , 1. ]])
    >>> found.near_null.ravel()
    array([2., 1.])
    """
    inside = np.flatnonzero(labels >= 0)
    order = inside[np.argsort(labels[inside], kind="stable")]
    starts = np.concatenate(([0], np.cumsum(np.bincount(labels[inside], minlength=count))))
    Q, R, ranks = local_bases(frozen_int(starts), frozen_int(order), frozen_float(near_null))
    offsets = np.concatenate(([0], np.cumsum(ranks)))
    columns = np.arange(near_null.shape[1])
    mask = (columns < ranks[labels][:, None]) & (labels >= 0)[:, None]
    indptr = np.concatenate(([0], np.cumsum(mask.sum(axis=1))))
    at = (offsets[labels][:, None] + columns)[mask]
    T = _csr(Q[mask], at, indptr, (len(labels), int(offsets[-1])))
    coarse = R[columns < ranks[:, None]]
    return Tentative(T, frozen_int(offsets), frozen_float(coarse), mask, labels, R)


def smoothed(
    A: Any,
    offsets: Int,
    part_of: Int,
    strength: Couplings,
    start: Tentative,
    near_null: Float,
    weak: float,
    steps: int = 1,
) -> Any:
    """Return P = (I − ω D⁻¹ F)^steps T with ω = 4/3 λ_max(D⁻¹ F)⁻¹, as CSR.

    F is A without its weak blocks, whose action on the near-null vectors goes to the diagonal: F B = A B. D
    is the diagonal of A, by blocks: that of F may be small where a part has many weak neighbours, and would
    then move it far towards the few strong ones. More than one step needs weak = 0, where F is A.
    """
    indptr, indices, data, left = split_weak(
        A.indptr, A.indices, A.data, offsets, part_of, *strength, weak, frozen_float(near_null)
    )
    kept = sparse.csr_array((data, indices, indptr), shape=A.shape)
    if (np.diff(offsets) == 1).all():
        inverse = 1.0 / A.diagonal()
        kept.data *= np.repeat(inverse, np.diff(indptr))
        left *= inverse[:, None]
    else:
        D = _inverse_blocks(A, offsets, part_of)
        kept, left = sparse.csr_array(D @ kept), D @ left
    omega = 4.0 / 3.0 / _largest_eigenvalue(kept)
    P = start.T
    for _ in range(steps):
        change = kept @ P
        if left.any():
            change = change + start.of(left)
        P = P - omega * change
    return sparse.csr_array(P)


def _csr(data: Float, indices: Any, indptr: Any, shape: tuple[int, int]) -> Any:
    """CSR with indices as narrow as they may be: kernels are compiled for one width only."""
    width = np.int32 if max(len(data), *shape) < 2**31 else np.int64
    return sparse.csr_array((data, indices.astype(width), indptr.astype(width)), shape=shape)


def _largest_eigenvalue(K: Any) -> float:
    """An estimate from above, by power iteration from a fixed start, bounded by the largest row sum."""
    v = np.random.default_rng(0).standard_normal(K.shape[0])
    length = 1.0
    for _ in range(8):
        v = K @ (v / np.linalg.norm(v))
        length = float(np.linalg.norm(v))
        if length == 0.0:
            break
    bound = float(abs(K).sum(axis=1).max(initial=0.0))
    return max(min(1.1 * length, bound), 1e-300)


def _inverse_blocks(A: Any, offsets: Int, part_of: Int) -> Any:
    """Inverses of the diagonal blocks of A, as a sparse matrix; blocks of one size at a time."""
    n = A.shape[0]
    row = np.repeat(np.arange(n), np.diff(A.indptr))
    inside = part_of[row] == part_of[A.indices]
    row, column, value = row[inside], A.indices[inside].astype(np.int64), A.data[inside]
    part, sizes = part_of[row], np.diff(offsets)
    found = []
    for size in np.unique(sizes):
        group = np.flatnonzero(sizes == size)
        place = np.full(len(sizes), -1)
        place[group] = np.arange(len(group))
        mine = sizes[part] == size
        p = part[mine]
        blocks = np.zeros((len(group), size, size))
        blocks[place[p], row[mine] - offsets[p], column[mine] - offsets[p]] = value[mine]
        try:
            inverse = np.linalg.inv(blocks)
        except np.linalg.LinAlgError:
            raise OptionError(f"a diagonal block of {size} unknowns is singular; expected none") from None
        lines = offsets[group][:, None] + np.arange(size)
        found.append(
            (inverse.ravel(), np.repeat(lines, size, axis=1).ravel(), np.tile(lines, (1, size)).ravel())
        )
    values, rows, columns = (np.concatenate(each) for each in zip(*found, strict=True))
    return sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=(n, n)))
