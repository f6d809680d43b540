"""Laws for all kinds: repeatability, random state, output, degenerate input and 3-D."""

from __future__ import annotations

import contextlib
import io
from typing import Any

from numpy.typing import NDArray

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import ASKED, law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.surroundings import stdout_of_process
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.cases import cases_in_3d, tiny
from agglo_core.conformance.inputs.hard_cases import partitions_in_3d
from agglo_core.conformance.inputs.multigrid_cases import PARTS
from agglo_core.conformance.inputs.questions import (
    answer,
    global_random,
    plain,
    questions,
    same,
    select_accepted,
    with_suffix,
)
from agglo_core.conformance.laws.bisector import one_sided
from agglo_core.errors import AggloError
from agglo_core.registry import KINDS

_SEES_SPACE = tuple(kind for kind in ASKED if kind not in ("smoother", *PARTS))


@law(*KINDS)
def same_seed_same_result(subject: Subject) -> None:
    """Two objects with equal options give equal results for equal calls with the same seed."""
    for case in questions(subject):
        first, second = (_answer_repeatably(subject, case) for _ in range(2))
        require(
            same(first, second),
            f"on {case.name}: the same seed gave two results: take all random numbers from the rng or the "
            "seeds given; np.random.default_rng() without a seed differs each time",
        )


@law(*ASKED)
def no_memory(subject: Subject) -> None:
    """A repeated call of one object gives an equal result."""
    for case in questions(subject):
        tool = subject.build()
        first, second = (_answer_repeatably(subject, case, tool) for _ in range(2))
        require(
            same(first, second),
            f"on {case.name}: a repeated call gave a different answer: keep nothing between calls in self",
        )


@law(*KINDS)
def global_random_state(subject: Subject) -> None:
    """The global random state of Python, numpy or torch is neither read nor changed."""
    remedy = "draw from the generator (or from np.random.default_rng(seed)) it is given"
    for case in questions(subject):
        with global_random(1) as unmoved:
            first = plain(subject, subject.build(), case)
            require(unmoved(), f"on {case.name}: it drew from, or seeded, the global random state: {remedy}")
        with global_random(2):
            second = plain(subject, subject.build(), case)
        require(
            same(first, second), (f"on {case.name}: the result depends on the global random state: {remedy}")
        )


@law(*KINDS)
def says_nothing(subject: Subject) -> None:
    """Nothing is printed, because stdout is reserved for the calling program."""
    printed = io.StringIO()
    with stdout_of_process() as read_output, contextlib.redirect_stdout(printed):
        for case in questions(subject):
            answer(subject, subject.build(), case)
        text = printed.getvalue() or read_output().decode(errors="replace")
    require(
        not text,
        f"it printed {text!r:.60}: use logging.getLogger(__name__) instead of print",
    )


@law(*ASKED)
def survives(subject: Subject) -> None:
    """Degenerate input is accepted: one to three cells, coincident cells, interfaces without measure."""
    for case in select_accepted(subject, tiny(subject.kind)):
        values = plain(subject, subject.build(), case)
        if subject.kind == "bisector" and len(values) > 1 and not subject.fallback:
            partition_only = not (subject.has("bisect") or subject.has("bisect_level"))
            require(
                partition_only or not len(one_sided(case.given[0], values)),
                f"on {case.name}: all cells are on one side: if cells are indistinguishable, return any "
                "halving, such as np.arange(n) * 2 // n",
            )


@law(*_SEES_SPACE, when=lambda subject: subject.promised("3d") is None)
def space_served_or_refused(subject: Subject) -> None:
    """Without the promise 3d, 3-D meshes are handled or refused with an AggloError."""
    test_cases = [*cases_in_3d(subject.kind), *(partitions_in_3d() if subject.partitions else [])]
    for case in with_suffix(subject, test_cases) if subject.kind == "format" else test_cases:
        try:
            plain(subject, subject.build(), case)
        except Broken as error:
            if not isinstance(error.__cause__, AggloError):
                raise Broken(
                    f"{error}. If it supports only 2-D, raise agglo.MeshError('… exists only for 2-D meshes')"
                ) from error


def _answer_repeatably(subject: Subject, case: Case, tool: Any = None) -> NDArray[Any]:
    """Call ``tool`` or a newly built component with a fixed global random state.

    The use of the global state is judged by another law.
    """
    with global_random(1):
        return plain(subject, subject.build() if tool is None else tool, case)
