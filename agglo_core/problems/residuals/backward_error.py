"""Backward error of an iterate, compared with double-precision rounding."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float
from agglo_core.problems.iteration_history import History
from agglo_core.problems.residuals.sizes import size_ratio, two_norm
from agglo_core.problems.residuals.stiff_springs import stiffest_joint

LIMIT = 2.0 * float(np.finfo(float).eps)
"""Backward error limited by rounding: direct solvers reach a tenth to a half of this bound."""
_TWO_DIGITS = 0.01
"""Maximum energy error for an accurate x. Above, the matrix is numerically singular.
Benchmark: benchmarks/constants.py."""


def backward_error(A: Any, x: Float, b: Float) -> float | None:
    """Return ‖b − A x‖ / ‖|A| |x| + |b|‖, with entrywise magnitudes, or None if A is only an operator.

    x is the exact solution of a system with entries of A and b changed by at most this relative error.
    Rounding x, or computing b − A x, causes up to half an ulp each. Below :data:`LIMIT`, no solver in double
    precision does better, whatever the residual relative to ‖b‖.

    Parameters
    ----------
    A : (n, n) sparse or array
    x, b : (n,) float

    Examples
    --------
    >>> import numpy as np
    >>> A, b = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([3.0, 4.0])
    >>> f"{backward_error(A, np.array([1.0, 1.0 + 1e-8]), b):.1e}"
    '3.2e-09'
    """
    if not is_known(A):
        return None
    return size_ratio(two_norm(b - A @ x), two_norm(magnitudes(A, x) + np.abs(b)))


def is_known(A: Any) -> bool:
    """Return True if the entries of A are available: a sparse matrix or an array."""
    return sparse.issparse(A) or isinstance(A, np.ndarray)


def magnitudes(A: Any, x: Float) -> Float:
    """Return |A| |x| ``(n,)`` with entrywise magnitudes, or 0 if A is only an operator."""
    if not is_known(A):
        return np.zeros(len(x))
    product: Float = abs(A) @ np.abs(x)
    return product


def explain_joints(A: Any) -> str:
    """Return a remark on two unknowns coupled so strongly that rounding hides other couplings, if any.

    Examples
    --------
    >>> import numpy as np
    >>> A = np.eye(9)
    >>> A[:2, :2] += 1e12 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    >>> explain_joints(A)
    '; unknowns 0 and 1 are coupled so strongly (entry -1.0e+12) that rounding hides their other couplings'
    >>> explain_joints(np.eye(9))
    ''
    """
    joint = stiffest_joint(A) if is_known(A) else None
    if joint is None:
        return ""
    i, j = joint
    entry = f"entry {float(sparse.csr_array(A)[i, j]):.1e}"
    return (
        f"; unknowns {i} and {j} are coupled so strongly ({entry}) that rounding hides their other couplings"
    )


def explain_end(history: History, A: Any, b: Float) -> History:
    """Add the backward error of the iterate to a history that ended by stagnation.

    The history ``ended`` by ``"rounding"`` if the backward error is at most :data:`LIMIT` and the energy
    error leaves two digits. The reason then also states whether the energy error meets the tolerance, and
    only the residual cannot. The reason of any unconverged history names two stiffly joined unknowns, if
    present (:func:`explain_joints`).

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.authoring import History
    >>> from agglo_core.problems.residuals.backward_error import explain_end
    >>> A, b = sparse.diags_array([1.0, 2.0]).tocsr(), np.ones(2)
    >>> known = np.array([1.0, 0.5]), np.array([1.0, 1e-9]), False, "stagnation: 1e-9", 1e-10
    >>> explained = explain_end(History(*known, ended="stagnation"), A, b)
    >>> explained.ended, explained.reason
    ('rounding', 'as accurate as double precision allows (backward error 0e+00): 1e-9')
    """
    if not history.converged:
        history = replace(history, reason=history.reason + explain_joints(A))
    error = backward_error(A, history.x, b) if history.ended == "stagnation" else None
    if error is None:
        return history
    known = history.energy_error is not None and history.energy_error <= _TWO_DIGITS
    if not (known and error <= LIMIT):
        return replace(history, backward_error=error)
    sizes = history.reason.split(": ", 1)[-1]
    reason = f"as accurate as double precision allows (backward error {error:.0e}): {sizes}"
    reason += (
        "; the energy error meets this, only the residual cannot" if "energy error" in history.tests else ""
    )
    return replace(history, ended="rounding", backward_error=error, reason=reason)
