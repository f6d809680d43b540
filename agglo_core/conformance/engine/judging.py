"""One component, the laws that apply to it, and the result of each."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from agglo_core.conformance.base.law import Law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.surroundings import Snapshot
from agglo_core.conformance.base.verdict import Broken
from agglo_core.conformance.laws import laws_of
from agglo_core.errors import OptionError
from agglo_core.registry.containment import PLUGIN_FAILURES


@dataclass(frozen=True)
class Result:
    """Whether a component obeys one law.

    Attributes
    ----------
    law, sentence : str
        Name of the law and what it says.
    passed : bool
    message : str
        What was wrong and what to do; empty if it passed.
    seconds : float
        Wall clock.
    promise : str or None
        The promise that switched the law on.

    Examples
    --------
    >>> from agglo_core.split.geometric import InertialBisection
    >>> from agglo_core.conformance import check
    >>> first = check(InertialBisection())[0]
    >>> first.law, first.passed, first.message
    ('builds', True, '')
    """

    law: str
    sentence: str
    passed: bool
    message: str
    seconds: float
    promise: str | None = None


def laws_for(subject: Subject) -> Sequence[Law]:
    """The laws that apply, in order; never none.

    Raises
    ------
    OptionError
        If it cannot be built without an option.
    """
    before = Snapshot()
    try:
        subject.make()
    except OptionError:
        raise
    except PLUGIN_FAILURES:  # the law builds reports it
        pass
    finally:
        subject.disturbed.extend(before.changed())
        before.restore()
    chosen = [law for law in laws_of(subject.kind) if law.applies(subject)]
    if not chosen:
        raise OptionError(f"there are no laws for a {subject.kind}")
    return chosen


def judge(law: Law, subject: Subject) -> Result:
    """The result of one law; whatever the component raises is a failure.

    Settings of the process that it left changed are put back, so that the next law sees them change again.
    """
    start, before = time.perf_counter(), Snapshot()
    message = ""
    try:
        law.judge(subject)
    except Broken as error:
        message = str(error)
    except PLUGIN_FAILURES as error:
        message = f"{type(error).__name__}: {error}: the component raised where the law asks for an answer"
    seconds = time.perf_counter() - start
    if before.changed():
        before.restore()
    return Result(law.name, law.sentence, not message, message, seconds, law.promise)
