"""Laws for smoothers: error reduction, symmetry, pre- and post-smoothing, independent levels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import eigh

from agglo_core.arrays import Float, frozen_float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.drawing import drawn_law
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.questions import answer, in_words, plain, questions
from agglo_core.conformance.inputs.strategies import smoother_cases
from agglo_core.registry.containment import PLUGIN_FAILURES

_EXAMPLES = 30  # drawn levels for each law
_FEW = 16  # unknowns below which a level has no smooth and rough half
_EXACT = 1e-10
_GONE = 1e-8  # share of the error that counts as none
_LITTLE = 0.05  # share of the rough error that may always remain
_SHARE = 0.9  # largest ratio of the remaining rough error to the remaining smooth error


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES)
def smoothed_array(subject: Subject, case: Case) -> None:
    """``setup(level)`` returns a function of (b, x) whose result is real with shape (n,)."""
    result = answer(subject, subject.build(), case)
    require(
        isinstance(result, np.ndarray) and result.shape == (case.size,) and result.dtype.kind == "f",
        f"on {case.name}: smooth(b, x) returned {in_words(result)}, expected floats of shape "
        f"({case.size},): return all of the new x as an array, not a correction, matrix or list",
    )


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES)
def solution_kept(subject: Subject, case: Case) -> None:
    """The exact solution of A x = b stays unchanged, and so does x = 0 for b = 0."""
    level, _, x = case.given
    for exact in (0.0 * x, x):
        moved = np.abs(apply_smoother(subject, case, level.A @ exact, exact) - exact).max()
        require(
            moved <= _EXACT * np.abs(exact).max(),
            f"on {case.name}: it moved the exact solution by {moved:.1e}: add a correction computed from "
            "the residual b − A x alone, with the matrix level.A",
        )


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES)
def error_reduced(subject: Subject, case: Case) -> None:
    """The energy norm of the error decreases from any x, also for uneven matrices."""
    factor = _left_of(subject, case, case.given[2])
    require(
        factor < 1 - 1e-6,
        f"on {case.name}: the energy norm of the error is not reduced (factor {factor:.4g}): damp it, "
        "for instance by 4 / (3 λ), λ being the largest eigenvalue of the preconditioned matrix",
    )


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES)
def steps_counted(subject: Subject, case: Case) -> None:
    """Each further smoothing step, from 1 to 4 steps, leaves less of the error."""
    level, b, x = case.given
    if len(x) < _FEW or level.coarse is not None:
        return
    left = [_left_of(subject, replace(case, given=(replace(level, steps=k), b, x)), x) for k in range(1, 5)]
    require(
        all(after < (1 - 1e-6) * before or after < _GONE for before, after in pairwise(left)),
        f"on {case.name}: 1 to 4 steps leave {', '.join(f'{share:.4f}' for share in left)} of the error: "
        "apply the smoother level.steps times",
    )


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES)
def rough_error_damped(subject: Subject, case: Case) -> None:
    """Rough errors shrink by a factor at most 0.9 times that of smooth errors (without coarse correction)."""
    level = case.given[0]
    if level.coarse is not None or len(case.given[1]) < _FEW:
        return
    # Eigenvectors of D⁻¹A: the lower half is smooth, the upper half rough.
    A = level.A.toarray()
    _, modes = eigh(A, np.diag(A.diagonal()))
    half = len(A) // 2
    smooth, rough = (
        _left_of(subject, case, _combine_modes(part)) for part in (modes[:, :half], modes[:, half:])
    )
    require(
        rough <= max(_SHARE * smooth, _LITTLE),
        f"on {case.name}: {rough:.3f} is left of a rough error, {smooth:.3f} of a smooth one: the "
        "coarse levels reduce the smooth half, the smoother must reduce the rough half",
    )


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES, promise="symmetric")
def smoother_symmetric(subject: Subject, case: Case) -> None:
    """The remaining error is a linear function of the error, self-adjoint in the energy inner product."""
    A = case.given[0].A
    u, v = np.random.default_rng(3).standard_normal((2, A.shape[0]))
    Su, Sv, combined = (_error_left(subject, case, error) for error in (u, v, 2 * u - 3 * v))
    # Relative to the initial error: an exact solver leaves nothing but rounding.
    nonlinearity = np.abs(combined - 2 * Su + 3 * Sv).max() / (np.abs(u).max() + np.abs(v).max())
    require(
        nonlinearity <= 1e-8,
        f"on {case.name}: the remaining error is not linear in the initial error: conjugate gradients, "
        "or a step length that depends on x, are nonlinear",
    )
    gap = abs(u @ (A @ Sv) - v @ (A @ Su)) / (_energy(A, u) * _energy(A, v))
    require(
        gap <= 1e-8,
        f"on {case.name}: ⟨u, S v⟩ and ⟨S u, v⟩ differ by {gap:.1e}: sweep forwards and then backwards",
    )


def _combine_modes(modes: Float) -> Float:
    """Return the sum of modes ``(n, k)``, each with a random sign."""
    signs = np.random.default_rng(1).choice([-1.0, 1.0], modes.shape[1])
    return np.asarray(modes @ signs)


def apply_smoother(subject: Subject, case: Case, b: Float, x: Float) -> Float:
    """Apply a smoother to a right-hand side ``b`` and an approximation ``x``, both ``(n,)``."""
    new_case = Case(case.name, (case.given[0], frozen_float(b), frozen_float(x)))
    return plain(subject, subject.build(), new_case)


def _error_left(subject: Subject, case: Case, error: Float) -> Float:
    """Smooth an error ``(n,)``, and return the remaining error.

    The exact solution is 0.
    """
    return apply_smoother(subject, case, np.zeros(len(error)), error)


def _left_of(subject: Subject, case: Case, error: Float) -> float:
    """Return the share of an error ``(n,)`` that remains after smoothing, in the energy norm."""
    A = case.given[0].A
    return _energy(A, _error_left(subject, case, error)) / _energy(A, error)


def _energy(A: Any, x: Float) -> float:
    return float(np.sqrt(x @ (A @ x)))


_CLOSE = 1e-8


def _two_sided(subject: Subject) -> bool:
    """Return True if the smoother defines ``before`` or ``after`` for pre- and post-smoothing."""
    smooth = subject.build().setup(cases("smoother")[0].given[0])
    return hasattr(smooth, "before") or hasattr(smooth, "after")


@law("smoother", when=_two_sided)
def both_sides(subject: Subject) -> None:
    """``before`` and ``after`` are defined together, and return (x, residual) and x, respectively."""
    for case in questions(subject):
        n = case.size
        x, r = _before(subject, case, case.given[1])
        for name, array in (("x", x), ("residual", r), ("x", _after(subject, case, *case.given[1:]))):
            require(
                isinstance(array, np.ndarray) and array.shape == (n,) and array.dtype.kind == "f",
                f"on {case.name}: {name} is {in_words(array)}, expected floats of shape ({n},): before(b) "
                "returns the pair (x, b − A x), after(b, x) the new x",
            )


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES, when=_two_sided)
def residual_of_before(subject: Subject, case: Case) -> None:
    """``before`` returns the residual b − A x, and an x that is linear in b."""
    A, (u, v) = case.given[0].A, _pair(case)
    (x, r), (y, _), (combined, _) = (_before(subject, case, b) for b in (u, v, 2 * u - 3 * v))
    gap = np.abs(r - (u - A @ x)).max() / np.abs(u).max()
    require(
        gap <= _CLOSE,
        f"on {case.name}: the residual is off by {gap:.1e}: return b − A x for the returned x",
    )
    nonlinearity = np.abs(combined - 2 * x + 3 * y).max() / (np.abs(x).max() + np.abs(y).max() + 1e-300)
    require(
        nonlinearity <= _CLOSE,
        f"on {case.name}: before(2 u − 3 v) differs from 2 before(u) − 3 before(v) by "
        f"{nonlinearity:.1e}: use only b, and no step length that depends on it",
    )


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES, when=_two_sided)
def after_mirrors_before(subject: Subject, case: Case) -> None:
    """If ``before`` gives x = B b, ``after`` gives x + Bᵀ (b − A x), so that cycles are symmetric."""
    A, (u, v) = case.given[0].A, _pair(case)
    # The update depends only on the residual.
    moved = _after(subject, case, u, v) - v
    alone = _after(subject, case, u - A @ v, np.zeros(len(u)))
    gap = np.abs(moved - alone).max() / np.abs(moved).max()
    require(
        gap <= _CLOSE,
        f"on {case.name}: after(b, x) − x and after(b − A x, 0) differ by {gap:.1e}: use only the residual",
    )
    # B and Bᵀ are adjoint.
    vBu, uBtv = float(v @ _before(subject, case, u)[0]), float(u @ _after(subject, case, v, 0 * v))
    asymmetry = abs(vBu - uBtv) / (np.linalg.norm(u) * np.linalg.norm(alone))
    require(
        asymmetry <= _CLOSE,
        f"on {case.name}: v·B u and u·Bᵀ v differ by {asymmetry:.1e}: after the correction apply the "
        "steps in reverse order",
    )


@law("smoother", when=_two_sided)
def sides_leave_b(subject: Subject) -> None:
    """``before`` and ``after`` leave the right-hand side unchanged, and ``before`` returns new arrays."""
    for case in questions(subject):
        b = np.array(case.given[1])
        b_copy = b.copy()
        x, r = _before(subject, case, b)
        require(
            not (np.shares_memory(x, b) or np.shares_memory(r, b)),
            f"on {case.name}: before(b) returned b itself, which the cycle still needs: return a copy",
        )
        _after(subject, case, b, np.zeros(len(b)))
        require(
            np.array_equal(b, b_copy),
            f"on {case.name}: b was changed, which the cycle still needs: use a copy",
        )


def _pair(case: Case) -> tuple[Float, Float]:
    u, v = np.random.default_rng(7).standard_normal((2, len(case.given[1])))
    return frozen_float(u), frozen_float(v)


def _before(subject: Subject, case: Case, b: Float) -> tuple[Any, Any]:
    pair = _call_method(subject, case, "before", b)
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise Broken(f"on {case.name}: before(b) returned {in_words(pair)}, expected the pair (x, b − A x)")
    return pair


def _after(subject: Subject, case: Case, b: Float, x: Float) -> Any:
    return _call_method(subject, case, "after", b, np.array(x))  # x may be changed


def _call_method(subject: Subject, case: Case, method: str, *arguments: Float) -> Any:
    """Set up the smoother of a test case, and call its method ``before`` or ``after``."""
    try:
        side = getattr(subject.build().setup(case.given[0]), method, None)
        if not callable(side):
            raise Broken(
                f"on {case.name}: there is no {method}: define both before and after, or only smooth(b, x)"
            )
        return side(*arguments)
    except Broken:
        raise
    except PLUGIN_FAILURES as error:
        raise Broken(f"on {case.name}: {method} raised {error!r:.200}") from error


_FACTORS = (2.0**20, 2.0**-20)


@drawn_law("smoother", draw=smoother_cases, fixed=questions, examples=_EXAMPLES)
def unit_of_the_matrix(subject: Subject, case: Case) -> None:
    """Multiplying matrix and right-hand side by the same factor does not change x."""
    level, b, x = case.given
    if level.coarse is not None:
        return
    before = apply_smoother(subject, case, b, x)
    for factor in _FACTORS:
        scaled = replace(level, A=factor * level.A, inherited=factor * level.inherited)
        after = apply_smoother(subject, replace(case, given=(scaled, b, x)), factor * b, x)
        change = np.abs(after - before).max() / np.abs(before).max()
        require(
            change <= 1e-6,
            f"on {case.name}, A and b times {factor:g}: x changed by {change:.1e}: a step length has "
            "the unit of 1 / A; divide by the diagonal, or by a bound of λ_max",
        )


@law("smoother")
def levels_apart(subject: Subject) -> None:
    """The result of ``setup`` for a level is not affected by the setup and use of other levels."""
    tool, test_cases = subject.build(), questions(subject)
    smoothers = [(case, _set_up(tool, case)) for case in test_cases]
    for case, smooth in [*smoothers, *smoothers[::-1]]:
        shared = _call_smooth(smooth, case)
        alone = plain(subject, subject.build(), case)
        require(
            shared.shape == alone.shape and np.allclose(shared, alone, rtol=1e-9, atol=1e-12),
            f"on {case.name}, after setting up other levels: x differs from the result without them: keep "
            "the data of a level in the function that setup returns, not in self",
        )


def _set_up(tool: Any, case: Case) -> Callable[[Float, Float], Any]:
    try:
        smooth: Callable[[Float, Float], Any] = tool.setup(case.given[0])
    except PLUGIN_FAILURES as error:
        raise Broken(f"on {case.name}, after other levels: setup raised {error!r:.200}") from error
    return smooth


def _call_smooth(smooth: Callable[[Float, Float], Any], case: Case) -> Float:
    try:
        return np.asarray(smooth(*case.given[1:]))
    except PLUGIN_FAILURES as error:
        raise Broken(
            f"on {case.name}, after setting up other levels: it raised {error!r:.200}: keep the data of a "
            "level in the function that setup returns, not in self"
        ) from error
