"""Laws for smoothers: error reduction, symmetry, pre- and post-smoothing."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import eigh

from agglo_core.arrays import Float, frozen_float
from agglo_core.conformance.base import Broken, Case, Subject, as_array, in_words, law, require, require_array
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.questions import plain
from agglo_core.conformance.inputs.strategies import smoother_cases
from agglo_core.conformance.laws.multigrid_parts import require_linear_and_symmetric
from agglo_core.registry.containment import PLUGIN_FAILURES

_EXAMPLES = 30  # drawn levels for each law
_FEW = 16  # unknowns below which a level has no smooth and rough half
_GONE = 1e-8  # share of the error that counts as none


@law("smoother", draw=smoother_cases, examples=_EXAMPLES)
def solution_kept(subject: Subject, case: Case) -> None:
    """The exact solution of A x = b stays unchanged, and so does x = 0 for b = 0."""
    level, _, x = case.given
    for exact in (0.0 * x, x):
        moved = np.abs(_smoothed(subject, case, level.A @ exact, exact) - exact).max()
        require(
            moved <= 1e-10 * np.abs(exact).max(),
            f"it moved the exact solution by {moved:.1e}: add a correction computed from the residual b − A "
            "x alone, with the matrix level.A",
        )


def _mixed_cases(subject: Subject) -> Any:
    """Draw levels, also with strongly coupled unknowns of a cell, where a fixed damping diverges."""
    return smoother_cases(subject, mixings=(0.05, 0.9))


@law("smoother", draw=_mixed_cases, examples=_EXAMPLES)
def error_reduced(subject: Subject, case: Case) -> None:
    """Each of 1 to 4 smoothing steps reduces the energy norm of the error, in any unit of the matrix."""
    level, b, x = case.given
    # A coarse correction may leave what further steps cannot see, and few unknowns are solved at once.
    steps = range(1, 5) if level.coarse is None and len(x) >= _FEW else [level.steps]
    left = [_share_left(subject, replace(case, given=(replace(level, steps=k), b, x)), x) for k in steps]
    require(
        all(after < (1 - 1e-6) * before or after < _GONE for before, after in pairwise([1.0, *left])),
        f"{list(steps)} steps leave {', '.join(f'{share:.4f}' for share in left)} of the error in the "
        "energy norm: damp it, for instance by 4 / (3 λ), λ being the largest eigenvalue of the "
        "preconditioned matrix, and apply it level.steps times; a step length has the unit of 1 / A",
    )


@law("smoother", draw=smoother_cases, examples=_EXAMPLES)
def rough_error_damped(subject: Subject, case: Case) -> None:
    """Rough errors shrink by a factor at most 0.9 times that of smooth errors (without coarse correction)."""
    level = case.given[0]
    if level.coarse is not None or len(case.given[1]) < _FEW:
        return
    # Eigenvectors of D⁻¹A with random signs: the lower half is smooth, the upper half rough.
    A = level.A.toarray()
    _, modes = eigh(A, np.diag(A.diagonal()))
    signed = modes * np.random.default_rng(1).choice([-1.0, 1.0], len(A))
    half = len(A) // 2
    smooth, rough = (
        _share_left(subject, case, part.sum(axis=1)) for part in (signed[:, :half], signed[:, half:])
    )
    require(
        rough <= max(0.9 * smooth, 0.05),
        f"{rough:.3f} is left of a rough error, {smooth:.3f} of a smooth one: the coarse levels reduce the "
        "smooth half, the smoother must reduce the rough half",
    )


@law("smoother", draw=smoother_cases, examples=_EXAMPLES, promise="symmetric")
def smoother_symmetric(subject: Subject, case: Case) -> None:
    """The remaining error is a linear function of the error, self-adjoint in the energy inner product."""
    A = case.given[0].A
    require_linear_and_symmetric(
        A.shape[0],
        lambda error: _smoothed(subject, case, 0.0 * error, error),
        "step lengths that depend on x, as in conjugate gradients, are nonlinear",
        energy=A,
    )


def _smoothed(subject: Subject, case: Case, b: Float, x: Float) -> Float:
    """Apply a smoother to a right-hand side and an approximation, both ``(n,)``."""
    new_case = Case(case.name, (case.given[0], frozen_float(b), frozen_float(x)))
    return plain(subject, new_case)


def _share_left(subject: Subject, case: Case, error: Float) -> float:
    """Return the share of an error ``(n,)`` that remains after smoothing, in the energy norm."""
    A = case.given[0].A
    left = _smoothed(subject, case, 0.0 * error, error)
    return float(np.sqrt((left @ (A @ left)) / (error @ (A @ error))))


def _two_sided(subject: Subject) -> bool:
    """Return True if the smoother defines ``before`` or ``after`` for pre- and post-smoothing."""
    smooth = subject.build().setup(cases("smoother")[0].given[0])
    return hasattr(smooth, "before") or hasattr(smooth, "after")


@law("smoother", draw=smoother_cases, examples=_EXAMPLES, when=_two_sided)
def both_sides(subject: Subject, case: Case) -> None:
    """``before(b)`` returns new arrays x and b − A x, ``after(b, x)`` returns x, and both leave b alone."""
    A, b = case.given[0].A, np.array(case.given[1])
    x, r = _before(subject, case, b)
    for array, method in ((x, "before"), (r, "before"), (_after(subject, case, b, case.given[2]), "after")):
        remedy = "before(b) returns the pair (x, b − A x), after(b, x) the new x"
        require_array(array, b.shape, "f", remedy, method)
    require(
        np.array_equal(b, case.given[1]) and not (np.shares_memory(x, b) or np.shares_memory(r, b)),
        "b, which the cycle still needs, was changed or returned by before or after: use a copy",
    )
    gap = np.abs(r - (b - A @ x)).max() / np.abs(b).max()
    require(gap <= 1e-8, f"the residual is off by {gap:.1e}: return b − A x for the returned x")


@law("smoother", draw=smoother_cases, examples=_EXAMPLES, when=_two_sided)
def after_mirrors_before(subject: Subject, case: Case) -> None:
    """If ``before`` gives x = B b, B is linear and ``after`` gives x + Bᵀ (b − A x)."""
    A = case.given[0].A
    u, v = np.random.default_rng(7).standard_normal((2, A.shape[0]))
    # The update depends only on the residual, and linearly.
    moved, alone = _after(subject, case, u, v) - v, _after(subject, case, u - A @ v, 0.0 * v)
    gap = np.abs(moved - alone).max() / np.abs(moved).max()
    require(gap <= 1e-8, f"after(b, x) − x and after(b − A x, 0) differ by {gap:.1e}: use only the residual")
    require_linear_and_symmetric(
        A.shape[0],
        lambda b: _before(subject, case, b)[0],
        "use only b, and no step length that depends on it",
        adjoint=lambda b: _after(subject, case, b, 0.0 * b),
    )


def _before(subject: Subject, case: Case, b: Float) -> tuple[Any, Any]:
    pair = _call_method(subject, case, "before", b)
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise Broken(f"before(b) returned {in_words(pair)}, expected the pair (x, b − A x)")
    return as_array(pair[0]), as_array(pair[1])


def _after(subject: Subject, case: Case, b: Float, x: Float) -> Any:
    return as_array(_call_method(subject, case, "after", b, np.array(x)))  # x may be changed


def _call_method(subject: Subject, case: Case, method: str, *arguments: Float) -> Any:
    """Set up the smoother of a test case, and call its method ``before`` or ``after``."""
    try:
        side = getattr(subject.build().setup(case.given[0]), method, None)
        if callable(side):
            return side(*arguments)
    except PLUGIN_FAILURES as error:
        raise Broken(f"{method} raised {error!r:.200}") from error
    raise Broken(f"there is no {method}: define both before and after, or only smooth(b, x)")
