"""Linear systems as methods for real symmetric matrices take them."""

from __future__ import annotations

from typing import Any

from scipy import sparse

from agglo_core.arrays import Float, frozen_float
from agglo_core.errors import OptionError
from agglo_core.problems.linear import Linear
from agglo_core.problems.real_arrays import real_array, real_matrix, require_finite, require_symmetric


def symmetric_system(problem: Linear) -> tuple[sparse.csr_array, Float]:
    """Matrix ``(n, n)`` and right-hand side ``(n,)`` of a linear problem as real numbers.

    Raises
    ------
    OptionError
        For a matrix without entries (a LinearOperator), one that is not square or not symmetric; several
        right-hand sides, or a sparse one; complex numbers, values that are not numbers or not finite; shapes
        that do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core.authoring import symmetric_system
    >>> A, b = symmetric_system(agglo.Linear([[2, -1], [-1, 2]], [1, 0], np.arange(3)))
    >>> A.toarray(), b
    (array([[ 2., -1.],
           [-1.,  2.]]), array([1., 0.]))
    """
    b, A = _vector(problem.b), sparse.csr_array(real_matrix(problem.A))
    unknowns = int(problem.block_offsets[-1])
    if A.shape != (unknowns, unknowns) or b.shape != (unknowns,):
        raise OptionError(
            f"A has the shape {A.shape} and b {b.shape}; block_offsets are for {unknowns} unknowns"
        )
    require_finite(b, A)
    require_symmetric(A)
    return A, b


def _vector(given: Any) -> Float:
    if sparse.issparse(given):
        raise OptionError(f"b must be an array (n,), given a sparse one {given.shape}: b.toarray().ravel()")
    b = real_array("b", given)
    if b.ndim == 2:
        raise OptionError(
            f"b must be one right-hand side (n,), given the shape {b.shape}: solve for one column at a time"
        )
    return frozen_float(b)
