"""Row sizes of a symmetric matrix, and residual measures and loads that account for them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.problems.residuals.backward_error import is_known
from agglo_core.problems.residuals.sizes import Measure, relative_to
from agglo_core.problems.residuals.stiff_springs import imposed_differences

#: Maximum ratio of row sizes up to which residuals are measured by the 2-norm alone (benchmarks/constants.py)
_ALIKE = 100.0
#: Minimum ratio of a penalty to the other entries in its row, and to the smallest row size
#: (benchmarks/constants.py)
_PENALTY = 1e3


def row_sizes(A: Any) -> Float:
    """Return a positive size per row ``(n,)``: the diagonal entry or, if not positive, the largest entry.

    In a positive definite matrix, |a_ij| < (a_ii a_jj)^½, so these sizes scale the entries independently of
    the units of the unknowns. A zero row has size 1.

    Parameters
    ----------
    A : (n, n) sparse or array

    Examples
    --------
    >>> import numpy as np
    >>> row_sizes(np.array([[1e12, -1.0], [-1.0, 2.0]]))
    array([1.e+12, 2.e+00])
    """
    sizes = np.array(A.diagonal(), dtype=np.float64)
    if not (sizes > 0.0).all():
        largest = np.asarray(abs(sparse.csr_array(A)).max(axis=1).todense()).ravel()
        sizes = np.where(sizes > 0.0, sizes, np.where(largest > 0.0, largest, 1.0))
    return frozen_float(sizes)


def row_measure(A: Any, b: Float) -> Measure:
    """Return a measure of residuals r of A x = b that respects large and small rows.

    The measure is ‖r‖ / ‖b‖ for rows of similar size. Otherwise it is the largest of three ratios, for r and
    b, D^-½ r and D^-½ b, D⁻¹ r and D⁻¹ b, with the row sizes D. Otherwise loads in rows with large entries
    would hide residuals in rows with small entries, and vice versa. The second ratio is independent of the
    units of the unknowns.

    Parameters
    ----------
    A : (n, n) sparse, array or LinearOperator
        Row sizes of a LinearOperator are unknown.
    b : (n,) float

    Examples
    --------
    >>> import numpy as np
    >>> measure = row_measure(np.diag([1e12, 1.0]), np.array([1e12, 0.0]))
    >>> measure(np.array([0.0, 0.5]))
    0.5
    """
    relative_norm = relative_to(b)
    sizes = row_sizes(A) if is_known(A) else frozen_float([])
    if not len(sizes) or not sizes.max() > _ALIKE * sizes.min():
        return relative_norm
    root = np.sqrt(np.median(sizes)) / np.sqrt(sizes)
    scaled = [(weight, relative_to(weight * b)) for weight in (root, root * root)]
    return lambda r: max(relative_norm(r), *(measure(weight * r) for weight, measure in scaled))


def penalised_rows(A: Any) -> Int:
    """Return the indices of rows with a penalty: a diagonal entry that alone determines the unknown.

    Such an entry is a thousand times the sum of the others in its row, and a thousand times the least
    diagonal entry, as for values imposed by a large diagonal number.

    Parameters
    ----------
    A : (n, n) sparse, array or LinearOperator
        Rows of a LinearOperator are unknown.

    Examples
    --------
    >>> import numpy as np
    >>> penalised_rows(np.array([[1e12, -1.0], [-1.0, 2.0]]))
    array([0])
    """
    if not is_known(A):
        return frozen_int([])
    diagonal, sizes = np.asarray(A.diagonal(), dtype=np.float64), row_sizes(A)
    large = frozen_int(np.flatnonzero(diagonal >= _PENALTY * sizes.min(initial=np.inf)))
    if not len(large):
        return large
    others = abs(_rows_without_diagonal(A, large)).sum(axis=1)
    return frozen_int(large[diagonal[large] >= _PENALTY * others])


def lifted(A: Any, b: Float, rows: Int | None = None) -> tuple[Float, Float]:
    """Solve penalised rows of A x = b by their diagonal, and return this offset and the remaining load.

    With x = offset + y, A y = load = b − A offset. Penalties times imposed values vanish from the load, so
    residuals and energies of y describe the other unknowns. In the given rows, the load is computed from the
    off-diagonal entries only: b_i − a_ii offset_i is 0 except for rounding of b_i.

    Loads across stiff springs are subtracted likewise
    (:func:`~agglo_core.problems.residuals.stiff_springs.imposed_differences`).

    Parameters
    ----------
    A : (n, n) sparse or array
    b : (n,) or (n, k) float
    rows : (m,) int, optional
        Default: :func:`penalised_rows`.

    Returns
    -------
    offset, load : float, with the shape of b

    Examples
    --------
    >>> import numpy as np
    >>> A = np.array([[1e12, -1.0], [-1.0, 2.0]])
    >>> lifted(A, np.array([3e12, 0.0]))
    (array([3., 0.]), array([0., 3.]))
    """
    rows = penalised_rows(A) if rows is None else rows
    offset = np.zeros(b.shape)
    if not is_known(A):
        return frozen_float(offset), b
    if not b[rows].any():
        return _remove_spring_loads(A, frozen_float(offset), b)
    offset[rows] = (b[rows].T / A.diagonal()[rows]).T
    load = b - A @ offset
    load[rows] = 0.0 - _rows_without_diagonal(A, rows) @ offset
    return _remove_spring_loads(A, frozen_float(offset), frozen_float(load))


def _remove_spring_loads(A: Any, offset: Float, b: Float) -> tuple[Float, Float]:
    """Add the differences across stiff springs to an offset, and return offset and remaining load."""
    sizes = row_sizes(A)
    imposed = [imposed_differences(A, column, sizes) for column in np.atleast_2d(b.T)]
    if all(column is None for column in imposed):
        return offset, b
    offsets, loads = np.atleast_2d(offset.T).copy(), np.atleast_2d(b.T).copy()
    for shift, load, column in zip(offsets, loads, imposed, strict=True):
        if column is not None:
            shift[column.members] += column.values
            differences = np.zeros(len(load))
            differences[column.members] = column.values
            load -= A @ differences
            load[column.members] = 0.0 - _rows_without(A, column.members, column.label) @ differences
    return frozen_float(offsets.T.reshape(b.shape)), frozen_float(loads.T.reshape(b.shape))


def _rows_without_diagonal(A: Any, rows: Int) -> Any:
    """Return the given rows ``(m, n)`` of a matrix, with the diagonal set to 0."""
    return _rows_without(A, rows, frozen_int(np.arange(A.shape[0])))


def _rows_without(A: Any, rows: Int, label: Int) -> Any:
    """Return the given rows ``(m, n)`` of a matrix, with entries between equal labels set to 0."""
    some = sparse.csr_array(sparse.csr_array(A)[rows])
    own = np.repeat(label[rows], np.diff(some.indptr))
    data = np.where(label[some.indices] == own, 0.0, some.data)
    return sparse.csr_array((data, some.indices, some.indptr), shape=some.shape)
