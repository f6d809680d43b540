"""Laws for all kinds: repeatability, and 3-D input."""

from __future__ import annotations

import numpy as np

from agglo_core.conformance.base import ASKED, Broken, Case, Subject, law, require
from agglo_core.conformance.inputs.multigrid_cases import PARTS
from agglo_core.conformance.inputs.questions import (
    answer,
    in_array,
    plain,
    questions,
    questions_in_3d,
    same,
    select_accepted,
)
from agglo_core.errors import AggloError


@law(*ASKED, fixed=questions)
def same_seed_same_result(subject: Subject, case: Case) -> None:
    """Equal calls with equal seeds give equal results, by two objects with equal options or by one."""
    tool = subject.build()
    first = answer(subject, case, tool)
    values = in_array(subject, case, first)
    for source, other in (("another", subject.build()), ("the same", tool)):
        second = answer(subject, case, other)
        solved_alike = getattr(first, "iterations", 0) == getattr(second, "iterations", 0)
        require(
            solved_alike and same(values, in_array(subject, case, second)),
            f"the same seed gave two results, the second by {source} object: take all random numbers from "
            "the rng or the seeds given, because np.random.default_rng() without a seed differs each time, "
            "and keep nothing between calls in self",
        )


_ON_MESHES = tuple(kind for kind in ASKED if kind not in ("smoother", *PARTS))


@law(promise="3d")
def space(subject: Subject) -> None:
    """3-D meshes have a finite result, also after a call on a 2-D mesh."""
    test_cases = questions_in_3d(subject)
    if subject.kind in ("solver", "format"):
        test_cases = select_accepted(subject, test_cases)
        require(test_cases or not subject.has("write"), "it refuses every 3-D mesh: drop the promise 3d")
    tool = subject.build()
    for case in questions(subject)[:1]:
        plain(subject, case, tool)
    for case in test_cases:
        values = plain(subject, case)
        require(
            same(values, plain(subject, case, tool)),
            f"on {case.name}: its answer changes after a call on a 2-D mesh: keep no dimension in self",
        )
        # Undefined values of metrics are NaN.
        finite = subject.kind == "metric" or bool(np.isfinite(values).all())
        require(finite, f"on {case.name}: values are {values[:4]}")


@law(*_ON_MESHES, fixed=questions_in_3d, when=lambda subject: subject.promised("3d") is None)
def space_served_or_refused(subject: Subject, case: Case) -> None:
    """Without the promise 3d, 3-D meshes are handled or refused with an AggloError."""
    try:
        plain(subject, case)
    except Broken as error:
        if not isinstance(error.__cause__, AggloError):
            raise Broken(
                f"{error}. If it supports only 2-D, raise agglo.MeshError('… exists only for 2-D meshes')"
            ) from error
