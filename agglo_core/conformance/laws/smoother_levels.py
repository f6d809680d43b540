"""Laws of a smoother on several levels: each keeps its own, whatever the unit of its matrix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from agglo_core.arrays import Float
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.questions import plain, questions
from agglo_core.conformance.laws.level_smoother import smoothed
from agglo_core.registry.containment import PLUGIN_FAILURES

_FACTORS = (2.0**20, 2.0**-20)


@law("smoother")
def unit_of_the_matrix(subject: Subject) -> None:
    """A matrix and a right-hand side multiplied by the same number give the same x."""
    for case in questions(subject):
        level, b, x = case.given
        if level.coarse is None:
            before = smoothed(subject, case, b, x)
            for factor in _FACTORS:
                A = factor * level.A
                scaled = replace(case, given=(replace(level, A=A, inherited=A), b, x))
                off = np.abs(smoothed(subject, scaled, factor * b, x) - before).max() / np.abs(before).max()
                require(
                    off <= 1e-6,
                    f"on {case.name}, A and b times {factor:g}: x changed by {off:.1e}: a step length has "
                    "the unit of 1 / A; divide by the diagonal, or by a bound of λ_max",
                )


@law("smoother")
def levels_apart(subject: Subject) -> None:
    """What ``setup`` returns for a level stays the same when other levels are set up and smoothed."""
    tool, asked = subject.build(), questions(subject)
    ready = [(case, _set_up(tool, case)) for case in asked]
    for case, smooth in [*ready, *ready[::-1]]:
        shared = _applied(smooth, case)
        alone = plain(subject, subject.build(), case)
        require(
            shared.shape == alone.shape and np.allclose(shared, alone, rtol=1e-9, atol=1e-12),
            f"on {case.name}, after setting up other levels: x is another one than alone: what a level needs "
            "belongs to the function that setup returns, not to self",
        )


def _set_up(tool: Any, case: Case) -> Callable[[Float, Float], Any]:
    try:
        smooth: Callable[[Float, Float], Any] = tool.setup(case.given[0])
    except PLUGIN_FAILURES as error:
        raise Broken(f"on {case.name}, after other levels: setup raised {error!r:.200}") from error
    return smooth


def _applied(smooth: Callable[[Float, Float], Any], case: Case) -> Float:
    try:
        return np.asarray(smooth(*case.given[1:]))
    except PLUGIN_FAILURES as error:
        raise Broken(
            f"on {case.name}, after setting up other levels: it raised {error!r:.200}: what a level needs "
            "belongs to the function that setup returns, not to self"
        ) from error
