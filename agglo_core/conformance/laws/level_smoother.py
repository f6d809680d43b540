"""Laws of what a smoother does to the error."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import eigh

from agglo_core.arrays import Float, frozen_float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.questions import answer, in_words, plain, questions
from agglo_core.conformance.inputs.solver_cases import uneven

_EXACT = 1e-10
_SHARE = 0.9  # of what is left of a smooth error, at most so much may be left of a rough one


@law("smoother")
def smoothed_array(subject: Subject) -> None:
    """``setup(level)`` gives a function of (b, x) that returns real numbers of shape (n,)."""
    for case in questions(subject):
        given = answer(subject, subject.build(), case)
        require(
            isinstance(given, np.ndarray) and given.shape == (case.size,) and given.dtype.kind == "f",
            f"on {case.name}: smooth(b, x) returned {in_words(given)}, expected floats of shape "
            f"({case.size},): the whole new x, not its change as a matrix or a list",
        )


@law("smoother")
def nothing_from_nothing(subject: Subject) -> None:
    """From b = 0 and x = 0 it returns 0."""
    for case in questions(subject):
        zero = np.zeros(case.size or 0)
        made = smoothed(subject, case, zero, zero)
        require(
            not np.any(made != 0), f"on {case.name}: it made {made[:3]} from zeros: only b − A x may enter"
        )


@law("smoother")
def solution_kept(subject: Subject) -> None:
    """The exact solution stays where it is."""
    for case in questions(subject):
        level, _, x = case.given
        moved = np.abs(smoothed(subject, case, level.A @ x, x) - x).max()
        require(
            moved <= _EXACT * np.abs(x).max(),
            f"on {case.name}: it moved the exact solution by {moved:.1e}: add a correction that is made of "
            "the residual b − A x alone",
        )


@law("smoother")
def error_reduced(subject: Subject) -> None:
    """From any x the error becomes smaller in the energy norm, of uneven matrices too."""
    for case in [*questions(subject), _uneven()]:
        A, x = case.given[0].A, case.given[2]
        left = _energy(A, _error_left(subject, case, x)) / _energy(A, x)
        require(
            left < 1 - 1e-6,
            f"on {case.name}: the energy norm of the error grew or stayed, by a factor {left:.4g}: damp it, "
            "for instance by 4 / (3 λ), λ being the largest eigenvalue of the preconditioned matrix",
        )


@law("smoother")
def rough_error_damped(subject: Subject) -> None:
    """Less is left of a rough error than of a smooth one, by a tenth at least (without coarse correction)."""
    for case in questions(subject):
        level = case.given[0]
        if level.coarse is None and len(case.given[1]) > 1:
            A = level.A.toarray()
            _, modes = eigh(A, np.diag(A.diagonal()))
            half = len(A) // 2
            smooth, rough = (
                _energy(A, _error_left(subject, case, error)) / _energy(A, error)
                for error in (_mixed(modes[:, :half]), _mixed(modes[:, half:]))
            )
            require(
                rough <= max(_SHARE * smooth, 1e-8),
                f"on {case.name}: {rough:.3f} is left of a rough error, {smooth:.3f} of a smooth one: the "
                "coarse levels reduce the smooth half, the smoother has to reduce the rough one",
            )


@law("smoother", promise="symmetric")
def smoother_symmetric(subject: Subject) -> None:
    """The error it leaves is a linear function of the error, self-adjoint in the energy inner product."""
    for case in questions(subject):
        A = case.given[0].A
        n = A.shape[0]
        u, v = np.random.default_rng(3).standard_normal((2, n))
        Su, Sv, both = (_error_left(subject, case, each) for each in (u, v, 2 * u - 3 * v))
        size = np.abs(both).max() + np.abs(Su).max()
        require(
            np.abs(both - 2 * Su + 3 * Sv).max() <= 1e-8 * size,
            f"on {case.name}: twice the error does not leave twice as much: conjugate gradients, or a step "
            "length that depends on x, are nonlinear",
        )
        gap = abs(u @ (A @ Sv) - v @ (A @ Su)) / (_energy(A, u) * _energy(A, v))
        require(
            gap <= 1e-8,
            f"on {case.name}: ⟨u, S v⟩ and ⟨S u, v⟩ differ by {gap:.1e}: sweep forwards and then backwards",
        )


def _uneven() -> Case:
    """A level whose couplings differ by 1 to 100."""
    case = cases("smoother")[0]
    level = case.given[0]
    A = uneven(small_meshes.grid(8, 8).graph, 1).A
    return replace(case, name="an uneven matrix", given=(replace(level, A=A, inherited=A), *case.given[1:]))


def _mixed(modes: Float) -> Float:
    """Equal amounts of some modes ``(n, k)`` with random signs."""
    signs = np.random.default_rng(1).choice([-1.0, 1.0], modes.shape[1])
    return np.asarray(modes @ signs)


def smoothed(subject: Subject, case: Case, b: Float, x: Float) -> Float:
    """What a smoother makes of a right-hand side and an x ``(n,)``."""
    asked = Case(case.name, (case.given[0], frozen_float(b), frozen_float(x)))
    return plain(subject, subject.build(), asked)


def _error_left(subject: Subject, case: Case, error: Float) -> Float:
    """What is left of an error: the solution is 0."""
    return smoothed(subject, case, np.zeros(len(error)), error)


def _energy(A: Any, x: Float) -> float:
    return float(np.sqrt(x @ (A @ x)))
