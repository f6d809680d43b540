"""Laws of arrays that belong to the caller, who may write to them: between calls, and the component never."""

from __future__ import annotations

from functools import partial

import numpy as np

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.own_arrays import arrays_in, home, in_own_arrays, written_meanwhile
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import require
from agglo_core.conformance.inputs.cases import cases
from agglo_core.conformance.inputs.questions import answer, global_random, plain, questions, same
from agglo_core.problems import Linear

_OWNED = ("refiner", "fixer", "metric", "solver", "smoother")
"""Kinds that are given arrays beside meshes and graphs, which nobody can write to."""

_FEW = 200  # values of a question: more are no other question


def _asked(subject: Subject) -> list[Case]:
    ordinary = {case.name for case in cases(subject.kind)}
    asked = [case for case in questions(subject) if case.name in ordinary and (case.size or 0) <= _FEW]
    return [own for case in asked[::-1] if arrays_in(own := in_own_arrays(case))][:4]


@law(*_OWNED)
def never_written(subject: Subject) -> None:
    """Arrays that it is given are not even changed for a while: others may read them meanwhile."""
    for case in _asked(subject):
        tool = subject.build()
        folder = home(subject.kind, tool)
        if folder is None:
            return
        line = written_meanwhile(partial(answer, subject, tool, case), folder, arrays_in(case))
        require(
            line is None,
            f"on {case.name}: the arrays given, or the matrix, are changed for a while (line {line}): "
            "whoever uses them at the same time gets wrong results; work on a copy",
        )


@law(*_OWNED)
def read_anew(subject: Subject) -> None:
    """Arrays in which the caller has put other numbers since the last call are read anew."""
    for case in _asked(subject):
        tool = subject.build()
        for _ in range(3):
            with global_random(1):
                given = plain(subject, tool, case)
            with global_random(1):
                wanted = plain(subject, subject.build(), in_own_arrays(case))
            require(
                same(given, wanted),
                f"on {case.name}, other numbers in the same arrays: it answers unlike a fresh object: "
                "an array is not known by being the same object; keep nothing by id()",
            )
            _change(case)


def _change(case: Case) -> None:
    """Other numbers in the same arrays: all the other way round, a cell in another part, a matrix doubled."""
    problem = case.given[0]
    if isinstance(problem, Linear):
        problem.b[:] = problem.b[::-1].copy()
        problem.A.data *= 2.0
        return
    for each in arrays_in(case):
        each[:] = each[::-1].copy()
        if each.dtype.kind == "i":
            movable = np.flatnonzero((np.bincount(each)[each] > 1) & (each != each[0]))
            each[movable[:1]] = each[0]
