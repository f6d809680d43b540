"""Laws of smoothers that do one thing before the correction by the next level, and another after it."""

from __future__ import annotations

from typing import Any

import numpy as np

from agglo_core.arrays import Float, frozen_float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.questions import in_words, questions
from agglo_core.registry.containment import PLUGIN_FAILURES

_CLOSE = 1e-8


def _two_sided(subject: Subject) -> bool:
    """Whether what its ``setup`` returns has one of the methods before and after."""
    smooth = subject.build().setup(cases("smoother")[0].given[0])
    return hasattr(smooth, "before") or hasattr(smooth, "after")


@law("smoother", when=_two_sided)
def both_sides(subject: Subject) -> None:
    """Where setup's answer has ``before`` or ``after`` it has both; they return (x, residual) and x."""
    for case in questions(subject):
        n = case.size
        x, r = _before(subject, case, case.given[1])
        for name, given in (("x", x), ("residual", r), ("x", _after(subject, case, *case.given[1:]))):
            require(
                isinstance(given, np.ndarray) and given.shape == (n,) and given.dtype.kind == "f",
                f"on {case.name}: {name} is {in_words(given)}, expected floats of shape ({n},): before(b) "
                "returns the pair (x, b − A x), after(b, x) the new x",
            )


@law("smoother", when=_two_sided)
def residual_of_before(subject: Subject) -> None:
    """The residual that ``before`` returns is b − A x, and x from 0 is linear in b."""
    for case in questions(subject):
        A, (u, v) = case.given[0].A, _pair(case)
        (x, r), (y, _), (both, _) = (_before(subject, case, b) for b in (u, v, 2 * u - 3 * v))
        gap = np.abs(r - (u - A @ x)).max() / np.abs(u).max()
        require(gap <= _CLOSE, f"on {case.name}: the residual is off by {gap:.1e}: it is b − A x of that x")
        bent = np.abs(both - 2 * x + 3 * y).max() / (np.abs(x).max() + np.abs(y).max() + 1e-300)
        require(
            bent <= _CLOSE,
            f"on {case.name}: before(2 u − 3 v) is not 2 before(u) − 3 before(v), by {bent:.1e}: nothing "
            "but b may enter, and no step length may depend on it",
        )


@law("smoother", when=_two_sided)
def after_mirrors_before(subject: Subject) -> None:
    """Where ``before`` takes x = B b, ``after`` takes x + Bᵀ (b − A x), so that cycles are symmetric."""
    for case in questions(subject):
        A, (u, v) = case.given[0].A, _pair(case)
        moved = _after(subject, case, u, v) - v
        alone = _after(subject, case, u - A @ v, np.zeros(len(u)))
        gap = np.abs(moved - alone).max() / np.abs(moved).max()
        require(
            gap <= _CLOSE,
            f"on {case.name}: what after(b, x) adds to x and after(b − A x, 0) differ by {gap:.1e}: only the "
            "residual may enter",
        )
        one, other = float(v @ _before(subject, case, u)[0]), float(u @ _after(subject, case, v, 0 * v))
        apart = abs(one - other) / (np.linalg.norm(u) * np.linalg.norm(alone))
        require(
            apart <= _CLOSE,
            f"on {case.name}: v·B u and u·Bᵀ v differ by {apart:.1e}: what is done first before the "
            "correction is done last after it",
        )


@law("smoother", when=_two_sided)
def sides_leave_b(subject: Subject) -> None:
    """Neither side changes the right-hand side, and ``before`` gives arrays of its own."""
    for case in questions(subject):
        b = np.array(case.given[1])
        kept = b.copy()
        x, r = _before(subject, case, b)
        require(
            not (np.shares_memory(x, b) or np.shares_memory(r, b)),
            f"on {case.name}: before(b) returned b itself, which the cycle still needs: return a copy",
        )
        _after(subject, case, b, np.zeros(len(b)))
        require(
            np.array_equal(b, kept), f"on {case.name}: b was changed, which the cycle still needs: use a copy"
        )


def _pair(case: Case) -> tuple[Float, Float]:
    u, v = np.random.default_rng(7).standard_normal((2, len(case.given[1])))
    return frozen_float(u), frozen_float(v)


def _before(subject: Subject, case: Case, b: Float) -> tuple[Any, Any]:
    made = _asked(subject, case, "before", b)
    if not isinstance(made, tuple) or len(made) != 2:
        raise Broken(f"on {case.name}: before(b) returned {in_words(made)}, expected the pair (x, b − A x)")
    return made


def _after(subject: Subject, case: Case, b: Float, x: Float) -> Any:
    return _asked(subject, case, "after", b, np.array(x))  # x may be changed


def _asked(subject: Subject, case: Case, method: str, *given: Float) -> Any:
    """The answer of a smoother set up afresh."""
    try:
        side = getattr(subject.build().setup(case.given[0]), method, None)
        if not callable(side):
            raise Broken(f"on {case.name}: there is no {method}: the two go together, or smooth(b, x) is all")
        return side(*given)
    except Broken:
        raise
    except PLUGIN_FAILURES as error:
        raise Broken(f"on {case.name}: {method} raised {error!r:.200}") from error
