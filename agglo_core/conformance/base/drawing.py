"""Laws as properties of drawn test cases, and the search for a small case that breaks a property."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from functools import wraps
from typing import Any
from zlib import crc32

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import Law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken

EXAMPLES = 100
"""Drawn cases for each law."""

_BATCH = 10
"""Cases drawn by one search: after ten, hypothesis mostly varies earlier cases."""

_SHRINKING = 4.0
"""CPU seconds to look for a smaller case that fails, too."""

Property = Callable[[Subject, Any], None]


def drawn_law(
    *kinds: str,
    draw: Callable[[Subject], Any],
    fixed: Callable[[Subject], Sequence[Any]] = lambda _: (),
    examples: int = EXAMPLES,
    promise: str | None = None,
    when: Callable[[Subject], bool] | None = None,
) -> Callable[[Property], Law]:
    """Decorator that turns a property of one test case into a law for these kinds of component.

    Parameters
    ----------
    *kinds : str
        Kinds of component.
    draw : callable
        Returns the hypothesis strategy of the test cases for a component, or None if there are none.
    fixed : callable
        Returns further test cases, which are judged afterwards.
    examples : int
        Number of drawn cases.
    promise, when
        As in :class:`~agglo_core.conformance.base.law.Law`.
    """

    def decorate(holds: Property) -> Law:
        @wraps(holds)
        def judge(subject: Subject) -> None:
            require_of_all(holds, subject, draw(subject), examples)
            for case in fixed(subject):
                try:
                    holds(subject, case)
                except Broken as error:
                    raise Broken(str(error), error.cause, _with_imports(case.code)) from error.__cause__

        return Law(kinds, promise, when, judge)

    return decorate


def require_of_all(holds: Property, subject: Subject, strategy: Any, examples: int = EXAMPLES) -> None:
    """Require a property of drawn test cases, which are the same in every run.

    Raises
    ------
    Broken
        If the property does not hold, for the smallest case found, with the code that makes it.
    """
    from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
    from hypothesis.errors import Flaky

    smallest: list[tuple[Case, Broken]] = []
    deadline: list[float] = []

    # After the time for shrinking all further candidates pass.
    def once(case: Case) -> None:
        if deadline and time.process_time() > deadline[0]:
            return
        try:
            holds(subject, case)
        except Broken as error:
            deadline[:] = deadline or [time.process_time() + _SHRINKING]
            smallest[:] = [(case, error)]
            raise

    if strategy is None:
        return
    name, examples = getattr(holds, "__name__", ""), min(examples, subject.draws)
    for batch in range(-(-examples // _BATCH)):
        configure = settings(
            max_examples=min(_BATCH, examples),
            database=None,
            deadline=None,
            derandomize=False,
            phases=(Phase.generate, Phase.shrink),
            report_multiple_bugs=False,
            suppress_health_check=list(HealthCheck),
            verbosity=Verbosity.quiet,
            print_blob=False,
        )
        number = crc32(f"{name} {batch}".encode())  # other cases for each law and batch
        seeded: Any = seed(number)
        search = seeded(configure(given(strategy)(once)))  # type: ignore[no-untyped-call]
        try:
            search()
        except (Broken, Flaky):
            if not smallest:
                raise
            break
    if smallest:
        case, error = smallest[0]
        raise Broken(str(error), error.cause, _with_imports(case.code)) from error.__cause__


def examples_of(strategy: Any, number: int) -> list[Any]:
    """Return a few drawn test cases, the simplest first, which are the same in every run."""
    from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings

    examples: list[Any] = []
    configure = settings(
        max_examples=number,
        database=None,
        deadline=None,
        phases=(Phase.generate,),
        suppress_health_check=list(HealthCheck),
        verbosity=Verbosity.quiet,
    )
    seeded: Any = seed(number)
    search = seeded(configure(given(strategy)(lambda example: examples.append(example))))  # type: ignore[no-untyped-call]
    search()
    return examples


def _with_imports(code: str) -> str:
    """Return the code that makes a drawn case, with the import of its recipes."""
    names = sorted(set(re.findall(r"\b(?:Drawn\w+|drawn_labels)(?=\()", code)))
    return f"from agglo_core.conformance import {', '.join(names)}\n{code}" if names else code
