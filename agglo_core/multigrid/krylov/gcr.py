"""Preconditioned generalised conjugate residuals, for matrices that need not be symmetric."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.multigrid.krylov.stopping import SAID, Rules
from agglo_core.multigrid.matrices.block_product import fast_product
from agglo_core.problems.iteration_history import MET, TESTS, Ended, History, iterated
from agglo_core.problems.residuals.backward_error import explain_end
from agglo_core.problems.residuals.sizes import Measure, two_norm
from agglo_core.progress import Notify, ignore_progress
from agglo_core.threads import one_blas_thread

_RESTART = 50
"""Directions kept until a restart: more take memory, fewer take iterations where M is poor."""
_DRIFT = 0.1
"""Maximum relative distance of the recursive residual from b − A x. Above, the iteration restarts."""
_LEAST_GAIN = 1e-8
"""Least relative reduction of ‖r‖ over a restart. Below, the iteration has stagnated."""
_STAGNATED = "rounding or a poor preconditioner prevents a further decrease of b − A x: "


def gcr(
    A: Any,
    b: Float,
    M: Callable[[Float], Float],
    x0: Float | None = None,
    *,
    tolerance: float = 1e-6,
    most: int = 1000,
    pace: float | None = None,
    measure: Measure,
    notify: Notify = ignore_progress,
) -> History:
    """Solve A x = b by flexible generalised conjugate residuals with restarts.

    The iterates are those of right-preconditioned flexible GMRES: each minimises ‖b − A x‖ over all
    directions since the last restart. Every step has its iterate and residual.

    Parameters
    ----------
    A : (n, n) sparse
        Nonsingular matrix.
    b : (n,) float
    M : callable
        Approximate inverse of A, which may change: maps a residual ``(n,)`` to a correction ``(n,)``.
    x0 : (n,) float, optional
        Initial iterate. Default: 0.
    tolerance : float
        Bound on the measure of b − A x, computed from x in double precision.
    most : int
        Maximum number of iterations.
    pace : float, optional
        Iterations of a good M from 0, see :func:`~agglo_core.multigrid.pcg`.
    measure : callable
        Residual measure.
    notify : callable, optional
        Receives the iteration progress.

    Returns
    -------
    History
        History with the last iterate. Energy errors are unknown, because A has no energy norm.

    Notes
    -----
    S. C. Eisenstat, H. C. Elman, M. H. Schultz, SIAM J. Numer. Anal. 20, 1983.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> from agglo_core.multigrid.krylov.gcr import gcr
    >>> A = sparse.csr_array([[4.0, 3.0], [1.0, 3.0]])
    >>> b = np.array([1.0, 2.0])
    >>> history = gcr(A, b, lambda r: r / A.diagonal(), measure=np.linalg.norm)
    >>> history.converged, history.iterations, (9 * history.x).round(8)
    (True, 2, array([-3.,  7.]))
    """
    rules, product = Rules(tolerance, most, "flexible", "residual", False, pace), fast_product(A)
    x = np.array(np.zeros(len(b)) if x0 is None or not b.any() else x0)
    r, kept = b - A @ x, list[tuple[Float, Float]]()
    residuals, size = [two_norm(r)], measure(r)
    ended: Ended = ""
    exact, begun = True, residuals[0]  # whether r is b − A x itself, and ‖r‖ at the last restart
    with one_blas_thread():  # vectors are too short for several
        while not ended:
            if not np.isfinite(residuals[-1]):
                ended = "matrix not finite"
            elif size <= tolerance and exact:
                ended = "met"
            elif size <= tolerance or len(kept) == _RESTART:
                # 1. Replace r by b − A x before a test that may be passed, and restart if they differ.
                true = b - A @ x
                drifted = two_norm(true - r) > _DRIFT * two_norm(true)
                r, exact, size = true, True, measure(true)
                if drifted or len(kept) == _RESTART:
                    stuck = not two_norm(r) < (1.0 - _LEAST_GAIN) * begun
                    ended = "stagnation" if stuck and size > tolerance else ""
                    kept, begun = [], two_norm(r)
            elif rules.exhausted(residuals, size):
                ended = "most iterations"
            else:
                # 2. Direction p and its image q = A p, made orthogonal to earlier images, twice for rounding.
                p = M(r)
                q = product @ p
                for _ in range(2):
                    for earlier, image in kept:
                        share = image @ q
                        p, q = p - share * earlier, q - share * image
                norm = two_norm(q)
                if not np.isfinite(norm):
                    ended = "preconditioner not finite"
                elif not norm > 0.0:
                    ended = "stagnation"
                else:
                    # 3. Step to the least residual along p.
                    p, q = p / norm, q / norm
                    kept.append((p, q))
                    alpha = q @ r
                    x, r, exact = x + alpha * p, r - alpha * q, False
                    residuals.append(two_norm(r))
                    size = measure(r)
                    notify(*iterated(len(residuals) - 1, size, tolerance))
    return _history(A, b, x, residuals, ended, measure, tolerance)


def _history(
    A: Any, b: Float, x: Float, residuals: list[float], ended: Ended, measure: Measure, tolerance: float
) -> History:
    """Return the history, with size and last 2-norm of b − A x computed from x."""
    r = b - A @ x
    size, met, steps = measure(r), ended == "met", len(residuals) - 1
    residuals[-1] = two_norm(r)
    passed = TESTS[:1] if size <= tolerance else ()
    sizes = f"relative residual {size:.1e} after {steps} iterations, required {tolerance:.1e}"
    cause = _STAGNATED if ended == "stagnation" else SAID.get(ended, "")
    reason = MET if met else cause + sizes
    arrays = frozen_float(x), frozen_float(residuals)
    return explain_end(History(*arrays, met, reason, None, passed, ended, size), A, b)
