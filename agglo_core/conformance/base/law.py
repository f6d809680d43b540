"""Laws: functions that test a component, and raise Broken with the fault and its remedy.

A law is a property of the component, or of the component and a test case. Test cases are drawn, and the
search for a small case that breaks the law is that of hypothesis.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import wraps
from inspect import cleandoc
from typing import Any, Final
from zlib import crc32

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken
from agglo_core.registry import KINDS
from agglo_core.registry.containment import PLUGIN_FAILURES

ASKED: Final = tuple(kind for kind in KINDS if kind != "sample")
"""Kinds whose components are called by the suite; a sample is only built."""

_BATCH = 10
"""Cases drawn by one search: after ten, hypothesis mostly varies earlier cases."""

_SHRINKING = 4.0
"""CPU seconds to look for a smaller case that fails, too."""


@dataclass(frozen=True)
class Law:
    """Property required of all components of some kinds, with the function that tests it.

    Attributes
    ----------
    kinds : tuple of str
        Kinds of component to which the law applies.
    promise : str or None
        Promise that switches the law on; None if the law always holds.
    when : callable or None
        Further condition on the subject, for instance a method or a name.
    judge : callable
        Raises :class:`Broken`; its docstring is the sentence of the law.
    """

    kinds: tuple[str, ...]
    promise: str | None
    when: Callable[[Subject], bool] | None
    judge: Callable[[Subject], None]

    @property
    def name(self) -> str:
        """Name of the law: the name of its test function."""
        return self.judge.__name__

    @property
    def sentence(self) -> str:
        """Statement of the law in one sentence: the docstring of its test function."""
        return " ".join(cleandoc(self.judge.__doc__ or "").split())

    def applies(self, subject: Subject) -> bool:
        """Return True if the component under test must obey this law."""
        if subject.kind not in self.kinds or (self.promise and subject.promised(self.promise) is None):
            return False
        try:
            return self.when is None or self.when(subject)
        except (Broken, *PLUGIN_FAILURES):  # judging the law then reports the error
            return True


def law(
    *kinds: str,
    draw: Callable[[Subject], Any] | None = None,
    fixed: Callable[[Subject], Sequence[Case]] | None = None,
    examples: int = 100,
    promise: str | None = None,
    when: Callable[[Subject], bool] | None = None,
) -> Callable[[Callable[..., None]], Law]:
    """Decorator that turns a test function into a law for these kinds of component.

    With ``draw`` or ``fixed`` the test function gets a component and a test case, else the component alone.
    The message of a failure then begins with the name of the case, unless it begins with "on".

    Parameters
    ----------
    *kinds : str
        Kinds of component; by default all that may make the promise, except samples.
    draw : callable, optional
        Returns the hypothesis strategy of the test cases for a component, or None if there are none.
    fixed : callable, optional
        Returns further test cases, which are judged afterwards.
    examples : int
        Number of drawn cases.
    promise, when
        As in :class:`Law`.
    """

    def decorate(holds: Callable[..., None]) -> Law:
        @wraps(holds)
        def judge(subject: Subject) -> None:
            strategy = draw(subject) if draw else None
            if strategy is not None:
                _require_of_drawn(holds, subject, strategy, min(examples, subject.draws))
            for case in fixed(subject) if fixed else ():
                try:
                    holds(subject, case)
                except Broken as error:
                    raise _on_case(error, case) from error.__cause__

        those = kinds or tuple(kind for kind in ASKED if promise in KINDS[kind].promises)
        return Law(those, promise, when, judge if draw or fixed else holds)

    return decorate


def _require_of_drawn(holds: Callable[..., None], subject: Subject, strategy: Any, examples: int) -> None:
    """Require a property of drawn test cases, and raise Broken for the smallest case found that breaks it."""
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

    for batch in range(-(-examples // _BATCH)):
        seed = crc32(f"{holds.__name__} {batch}".encode())  # other cases for each law and batch
        try:
            _search(once, strategy, seed, min(_BATCH, examples))
        except (Broken, Flaky):
            if not smallest:
                raise
            break
    if smallest:
        case, error = smallest[0]
        raise _on_case(error, case) from error.__cause__


def examples_of(strategy: Any, number: int) -> list[Any]:
    """Return a few drawn test cases, the simplest first, which are the same in every run."""
    examples: list[Any] = []
    _search(examples.append, strategy, number, number)
    return examples


def _search(function: Callable[[Any], None], strategy: Any, seed_number: int, examples: int) -> None:
    """Call a function with values drawn for a seed, and after an exception with smaller ones."""
    from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings

    configure = settings(
        max_examples=examples,
        database=None,
        deadline=None,
        phases=(Phase.generate, Phase.shrink),
        report_multiple_bugs=False,
        suppress_health_check=list(HealthCheck),
        verbosity=Verbosity.quiet,
        print_blob=False,
    )
    seeded: Any = seed(seed_number)
    seeded(configure(given(strategy)(lambda value: function(value))))()  # type: ignore[no-untyped-call]


def _on_case(error: Broken, case: Case) -> Broken:
    """Return a failure with the name of its case, and with the code that makes the case."""
    names = sorted(set(re.findall(r"\b(?:Drawn\w+|drawn_labels)(?=\()", case.code)))
    imports = f"from agglo_core.conformance import {', '.join(names)}\n" if names else ""
    message = str(error)
    return Broken(
        message if message.startswith("on ") else f"on {case.title}: {message}",
        error.cause,
        imports + case.code,
    )
