"""Preconditioned conjugate gradients for one or several right-hand sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from agglo_core.arrays import Float, frozen_float, plain_array
from agglo_core.errors import OptionError
from agglo_core.multigrid.krylov.column import Column
from agglo_core.multigrid.krylov.stopping import Beta, Request, Rules, Steps, Stop
from agglo_core.multigrid.matrices.block_product import fast_product
from agglo_core.problems.iteration_history import History, iterated
from agglo_core.problems.residuals.backward_error import explain_end, magnitudes
from agglo_core.problems.residuals.row_scales import lifted, penalised_rows, row_measure
from agglo_core.problems.residuals.sizes import Measure, energy_of_solution
from agglo_core.progress import Notify, ignore_progress
from agglo_core.suggestions import suggest_keywords
from agglo_core.threads import one_blas_thread


@suggest_keywords()
def pcg(
    A: Any,
    b: Float,
    M: Any = None,
    x0: Float | None = None,
    *,
    tolerance: float = 1e-6,
    most: int = 1000,
    beta: Beta = "flexible",
    stop: Stop = "energy",
    probe: bool = True,
    pace: float | None = None,
    measure: Measure | None = None,
    energy: Measure | None = None,
    notify: Notify = ignore_progress,
) -> History:
    """Solve A x = b by preconditioned conjugate gradients.

    Parameters
    ----------
    A : (n, n) sparse, array or LinearOperator
        Symmetric positive definite matrix.
    b : (n,) float
    M : (n, n) sparse, array or LinearOperator, or callable, optional
        Approximate inverse of A, symmetric and positive definite, such as a cycle. Maps a residual
        ``(n,)`` to a correction ``(n,)``.
    x0 : (n,) float, optional
        Initial iterate. Default: 0.
    tolerance : float
        Tolerance between 0 and 1.
    most : int
        Maximum number of iterations.
    beta : "flexible" or "fletcher-reeves"
        Coefficient of the last direction: z·(r − r_before) / (z·r)_before (Polak–Ribière) tolerates an M
        that changes a little or is slightly unsymmetric. z·r / (z·r)_before saves one product.
    stop : "energy", "residual" or "both"
        Quantities required to be at most ``tolerance``: the estimated energy error, the measure of b − A
        x, or both. Both are reported in any case.
    probe : bool
        Before convergence, search once from a random vector for eigenvalues of M A that b does not show.
        The search stops when z·r has lost four digits: three to five steps for a good M. Not necessary
        for an M known to be good.
    pace : float, optional
        Iterations of a good M from 0. An iteration ends if it is late by over 0.3 times as many, and at
        least 2, behind a uniform reduction of the residual measure. For an M with unknown quality.
    measure : callable, optional
        Residual measure. Default: ‖r‖ / ‖b‖ or, if row sizes of A differ by a factor above 100,
        :func:`~agglo_core.problems.residuals.row_scales.row_measure`.
    energy : callable, optional
        Function of x: the norm to compare ‖e‖_A with, for the error e. Default: (b·x)^½.
    notify : callable, optional
        Receives the iteration progress.

    Returns
    -------
    History
        History with the last iterate, which has the smallest energy error, converged or not. After a
        breakdown, the iterate has the smallest residual. ``ended`` names the breakdown. After
        ``preconditioner_failed``, an M in double precision may continue from ``x``. If a null vector of
        the matrix is found, the matrix is reported as singular, and b as outside its range.

    Raises
    ------
    OptionError
        For shapes that do not fit, values that are not real or not finite, or unknown options.

    Notes
    -----
    Convergence is always based on b − A x, computed from x. This vector replaces the recursive residual where
    the tests may be passed. If both differ by a tenth, the iteration restarts, and ends when restarts gain
    nothing. The energy error is bounded with the smallest Ritz value of M A, extrapolated by its last
    reduction. The tests must be passed again after a tenth more iterations, and with the probe's eigenvalues,
    so that slow modes are noticed.

    Values imposed by large diagonal numbers are eliminated first
    (:func:`~agglo_core.problems.residuals.row_scales.lifted`), unless ``measure`` or ``energy`` is given.
    Residuals and energies then describe the other unknowns. Otherwise the penalties times imposed values
    would dominate ‖b‖ and ‖x‖_A, and hide the other unknowns.

    Examples
    --------
    >>> from scipy import sparse
    >>> from agglo_core.multigrid import pcg
    >>> A = sparse.csr_array([[4.0, 1.0], [1.0, 3.0]])
    >>> found = pcg(A, [1.0, 2.0], lambda r: r / A.diagonal(), tolerance=1e-10)
    >>> found.converged, found.iterations, (11 * found.x).round(8)
    (True, 2, array([1., 7.]))
    """
    whole = _numbers("b", b)
    if whole.ndim != 1:
        raise OptionError(
            f"b must be one right-hand side (n,), given shape {whole.shape}; for several use pcg_columns"
        )
    rules = _rules(tolerance, most, beta, stop, probe, pace)
    start = np.zeros(len(whole)) if x0 is None else _numbers("x0", x0)
    _require_fit(A, M, whole, start)
    if measure is None and energy is None:
        return _solve_lifted(A, whole[:, None], M, start[:, None], rules, notify)[0]
    column = Column(
        whole, start, rules, measure or row_measure(A, whole), energy or energy_of_solution(whole)
    )
    _iterate(A, M, [column], notify)
    return explain_end(column.history(), A, whole)


@suggest_keywords()
def pcg_columns(
    A: Any,
    b: Float,
    M: Any = None,
    x0: Float | None = None,
    *,
    tolerance: float = 1e-6,
    most: int = 1000,
    beta: Beta = "flexible",
    stop: Stop = "energy",
    probe: bool = True,
    pace: float | None = None,
    notify: Notify = ignore_progress,
) -> tuple[History, ...]:
    """Run :func:`pcg` for several right-hand sides ``b (n, k)``, with a history per column.

    Each column has its own iteration, with count and result independent of the others. Products with A, and
    with an M that is not a function, are computed together.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy import sparse
    >>> A = sparse.csr_array(2.0 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1))
    >>> from agglo_core.multigrid import pcg_columns
    >>> found = pcg_columns(A, np.eye(6)[:, :2], lambda r: r / 2.0, tolerance=1e-10)
    >>> [history.converged for history in found]
    [True, True]
    """
    whole = _numbers("b", b)
    if whole.ndim != 2 or not whole.shape[1]:
        raise OptionError(f"b must be right-hand sides (n, k), given shape {whole.shape}; for one use pcg")
    rules = _rules(tolerance, most, beta, stop, probe, pace)
    start = np.zeros(whole.shape) if x0 is None else _numbers("x0", x0)
    _require_fit(A, M, whole, start)
    return _solve_lifted(A, whole, M, start, rules, notify)


def _solve_lifted(A: Any, b: Float, M: Any, x0: Float, rules: Rules, notify: Notify) -> tuple[History, ...]:
    """Solve A x = b ``(n, k)`` iteratively after elimination of the values imposed by penalties."""
    rows = penalised_rows(A)
    offset, load = lifted(A, b, rows)
    start = x0 - offset
    start[rows] = 0.0  # x0 − offset is rounding error here, times the penalty
    columns = [
        Column(each, y, rules, row_measure(A, each), energy_of_solution(each))
        for each, y in zip(np.ascontiguousarray(load.T), np.ascontiguousarray(start.T), strict=True)
    ]
    _iterate(A, M, columns, notify)
    histories = [explain_end(column.history(), A, column.b) for column in columns]
    if not offset.any():
        return tuple(histories)
    return tuple(
        replace(each, x=frozen_float(shift + each.x)) for each, shift in zip(histories, offset.T, strict=True)
    )


def _iterate(A: Any, M: Any, columns: Sequence[Column], notify: Notify) -> None:
    """Run the iterations of all right-hand sides together, with joint matrix products."""

    def sizes(vectors: list[Float]) -> list[Float]:
        return [magnitudes(A, entry) for entry in vectors]

    products = {"A": _product("A", fast_product(A)), "M": _product("M", M), "|A|": sizes}
    running: list[tuple[Column, Steps, Any]] = [(column, column.run(), None) for column in columns]
    # In each round, collect the requests of all columns, and answer them by operator.
    with one_blas_thread():  # vectors are too short for several
        while running:
            requests = [(column, steps, *_next_request(steps, answer)) for column, steps, answer in running]
            running = []
            for kind, product in products.items():
                group = [entry for entry in requests if entry[2] == kind]
                answers = product([entry[3] for entry in group]) if group else []
                running += [
                    (entry[0], entry[1], answer) for entry, answer in zip(group, answers, strict=True)
                ]
            if running:
                slowest = max((entry[0] for entry in running), key=lambda column: column.size)
                notify(*iterated(slowest.done, slowest.size, slowest.rules.tolerance))


def _next_request(steps: Steps, answer: Any) -> Request | tuple[None, None]:
    """Return the next product that an iteration requests (operator, vector), or None after its end."""
    try:
        return steps.send(answer)
    except StopIteration:
        return None, None


def _product(name: str, operator: Any) -> Callable[[list[Float]], list[Float]]:
    """Return a function that multiplies several vectors by an operator at once."""
    if operator is None:
        return lambda vectors: vectors
    if not hasattr(operator, "shape"):
        return lambda vectors: [_check_result(name, operator(each), each) for each in vectors]

    def together(vectors: list[Float]) -> list[Float]:
        if len(vectors) == 1:
            return [_check_result(name, operator @ vectors[0], vectors[0])]
        found = np.asarray(operator @ np.stack(vectors, axis=1), dtype=np.float64)
        return list(np.ascontiguousarray(found.T))

    return together


def _check_result(name: str, value: Any, vector: Float) -> Float:
    result = np.asarray(value, dtype=np.float64)
    if result.shape != vector.shape:
        raise OptionError(
            f"{name} must map vectors of shape {vector.shape} to vectors of that shape, but returned "
            f"{result.shape}"
        )
    return result


def _rules(tolerance: float, most: int, beta: Beta, stop: Stop, probe: bool, pace: float | None) -> Rules:
    if not 0.0 < tolerance < 1.0:
        raise OptionError(f"tolerance must be above 0 and below 1, given {tolerance!r}")
    if most < 0:
        raise OptionError(f"most, the largest number of iterations, must be 0 or more; given {most!r}")
    for name, given, known in (("beta", beta, get_args(Beta)), ("stop", stop, get_args(Stop))):
        if given not in known:
            raise OptionError(f"{name} must be one of {', '.join(known)}; given {given!r}")
    if pace is not None and not pace > 0.0:
        raise OptionError(f"pace must be above 0, given {pace!r}")
    return Rules(tolerance, most, beta, stop, probe, pace)


def _numbers(name: str, given: Any) -> Float:
    values = plain_array(given, name, OptionError)
    if values.dtype.kind not in "biuf":
        raise OptionError(f"{name} holds {values.dtype}; expected real numbers")
    if not np.isfinite(values).all():
        raise OptionError(f"{name} holds values that are not finite")
    return values.astype(np.float64)


def _require_fit(A: Any, M: Any, b: Float, x0: Float) -> None:
    n = len(b)
    if A.shape != (n, n):
        raise OptionError(f"A has shape {A.shape}, but b has shape {b.shape}")
    if hasattr(M, "shape") and M.shape != (n, n):
        raise OptionError(f"M has shape {M.shape}, but A has shape {A.shape}")
    if x0.shape != b.shape:
        raise OptionError(f"x0 has shape {x0.shape}, but b has shape {b.shape}")
