"""Prolongation of smoothed aggregation: near-null vectors on aggregates, smoothed by a Jacobi step."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, Mask, frozen, frozen_float, frozen_int
from agglo_core.errors import OptionError
from agglo_core.multigrid.kernels.aggregates import couplings, local_bases, split_weak


class Couplings(NamedTuple):
    """Coupling strengths between matrix parts as CSR, and the size (norm) per diagonal block."""

    graph: Int
    to: Any
    weight: Float
    size: Float

    @classmethod
    def of(cls, A: Any, offsets: Int, part_of: Int) -> Couplings:
        """Compute the couplings of a CSR matrix whose part p has the rows ``offsets[p]:offsets[p + 1]``."""
        found = couplings(A.indptr, A.indices, A.data, offsets, part_of)
        return cls(*(frozen(array, array.dtype) for array in found))

    def scaled(self, vector: Float) -> Couplings:
        """Return the couplings of diag(v) A diag(v), for single unknowns and a ``vector (n,)`` v."""
        row = np.repeat(vector, np.diff(self.graph))
        weight, size = self.weight * row * vector[self.to], self.size * vector**2
        return self._replace(weight=frozen_float(weight), size=frozen_float(size))

    @property
    def neighbours(self) -> float:
        """Mean neighbour count of a part."""
        return len(self.to) / max(len(self.size), 1)


@dataclass(frozen=True, eq=False)
class Tentative:
    """Tentative prolongation T: local orthonormal bases of near-null vectors B = T ``near_null``.

    Attributes
    ----------
    T : (n, m) sparse
        Prolongation with orthonormal columns.
    offsets : (aggregates + 1,) int
        Coarse unknowns of each aggregate.
    near_null : (m, k) float
        B on the coarse level.
    mask : (n, k) bool
        Columns of the aggregate that the rows of T contain.
    holder : (n,) int
        Aggregate per unknown, −1 for none.
    R : (aggregates, k, k) float
        B in each aggregate's basis.
    """

    T: Any
    offsets: Int
    near_null: Float
    mask: Mask
    holder: Int
    R: Float

    def of(self, values: Float) -> Any:
        """Multiply ``values (n, k)`` on each aggregate by the pseudo-inverse of R, the map from B to T."""
        single = self.R.shape[1] == 1
        back = 1.0 / np.where(self.R > 0.0, self.R, 1.0) if single else np.linalg.pinv(self.R)
        combined = np.einsum("ik,ikq->iq", values, back[self.holder])[self.mask]
        return sparse.csr_array((combined, self.T.indices, self.T.indptr), shape=self.T.shape)


def tentative(labels: Int, count: int, near_null: Float) -> Tentative:
    """Return the tentative prolongation of given aggregates (Vaněk, Mandel, Brezina, Computing 56, 1996).

    Parameters
    ----------
    labels : (n,) int
        Aggregate per unknown, −1 for none.
    count : int
        Aggregate count.
    near_null : (n, k) float

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.multigrid.coarsening.prolongation import tentative
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
    # Orthonormalise B on each aggregate.
    order = inside[np.argsort(labels[inside], kind="stable")]
    starts = np.concatenate(([0], np.cumsum(np.bincount(labels[inside], minlength=count))))
    Q, R, ranks = local_bases(frozen_int(starts), frozen_int(order), frozen_float(near_null))
    # Assemble T from the columns that exist on each aggregate.
    offsets = np.concatenate(([0], np.cumsum(ranks)))
    columns = np.arange(near_null.shape[1])
    mask = (columns < ranks[labels][:, None]) & (labels >= 0)[:, None]
    indptr = np.concatenate(([0], np.cumsum(mask.sum(axis=1))))
    at = (offsets[labels][:, None] + columns)[mask]
    T = _csr(Q[mask], at, indptr, (len(labels), int(offsets[-1])))
    coarse = R[columns < ranks[:, None]]
    return Tentative(T, frozen_int(offsets), frozen_float(coarse), mask, labels, R)


def smooth_tentative(
    A: Any,
    offsets: Int,
    part_of: Int,
    strength: Couplings,
    start: Tentative,
    near_null: Float,
    weak: float,
    steps: int = 1,
) -> Any:
    """Return the smoothed prolongation P = (I − ω D⁻¹ F)^steps T with ω = 4/3 λ_max(D⁻¹ F)⁻¹, as CSR.

    F is A without weak blocks, with their action on near-null vectors moved to the diagonal, so that F B = A
    B. D is the block diagonal of A, because the diagonal of F may be small for a part with many weak
    neighbours, and would move this part too far towards its few strong neighbours. More than one step
    requires weak = 0 (F = A).
    """
    indptr, indices, data, weak_action = split_weak(
        A.indptr, A.indices, A.data, offsets, part_of, *strength, weak, frozen_float(near_null)
    )
    F = sparse.csr_array((data, indices, indptr), shape=A.shape)
    if (np.diff(offsets) == 1).all():
        inverse = 1.0 / A.diagonal()
        F.data *= np.repeat(inverse, np.diff(indptr))
        weak_action *= inverse[:, None]
    else:
        D = _inverse_blocks(A, offsets, part_of)
        F, weak_action = sparse.csr_array(D @ F), D @ weak_action
    omega = 4.0 / 3.0 / _largest_eigenvalue(F)
    P = start.T
    for _ in range(steps):
        change = F @ P
        if weak_action.any():
            change = change + start.of(weak_action)
        P = P - omega * change
    return sparse.csr_array(P)


def _csr(data: Float, indices: Any, indptr: Any, shape: tuple[int, int]) -> Any:
    """Return a CSR matrix with 32-bit indices if possible, because kernels are compiled for one width."""
    width = np.int32 if max(len(data), *shape) < 2**31 else np.int64
    return sparse.csr_array((data, indices.astype(width), indptr.astype(width)), shape=shape)


def _largest_eigenvalue(K: Any) -> float:
    """Estimate the largest eigenvalue from above by power iteration, bounded by the largest row sum."""
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
    """Return the inverse diagonal blocks of A as a sparse matrix.

    Blocks of equal size are inverted together.
    """
    n = A.shape[0]
    # Collect the entries in diagonal blocks.
    row = np.repeat(np.arange(n), np.diff(A.indptr))
    inside = part_of[row] == part_of[A.indices]
    row, column, value = row[inside], A.indices[inside].astype(np.int64), A.data[inside]
    part, sizes = part_of[row], np.diff(offsets)
    triplets = []
    # Invert all blocks of equal size together.
    for size in np.unique(sizes):
        group = np.flatnonzero(sizes == size)
        place = np.full(len(sizes), -1)
        place[group] = np.arange(len(group))
        in_group = sizes[part] == size
        p = part[in_group]
        blocks = np.zeros((len(group), size, size))
        blocks[place[p], row[in_group] - offsets[p], column[in_group] - offsets[p]] = value[in_group]
        try:
            inverse = np.linalg.inv(blocks)
        except np.linalg.LinAlgError:
            raise OptionError(
                f"a diagonal block with {size} unknowns is singular; all must be invertible"
            ) from None
        lines = offsets[group][:, None] + np.arange(size)
        triplets.append(
            (inverse.ravel(), np.repeat(lines, size, axis=1).ravel(), np.tile(lines, (1, size)).ravel())
        )
    values, rows, columns = (np.concatenate(chunks) for chunks in zip(*triplets, strict=True))
    return sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=(n, n)))
