"""Select the laws that apply to a component, and test the component against them."""

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
    """Result of testing a component against one law.

    Attributes
    ----------
    law, sentence : str
        Law name and statement.
    passed : bool
        True if the component obeys the law.
    message : str
        Fault and remedy; empty if the law holds.
    seconds : float
        Wall-clock time.
    promise : str or None
        Promise that switched the law on.

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
    """Return the laws that apply to the component under test, in the order of testing.

    The list is never empty.

    Raises
    ------
    OptionError
        If the component cannot be built without an option, or its kind has no laws.
    """
    before = Snapshot()
    try:
        subject.make()
    except OptionError:
        raise
    except PLUGIN_FAILURES:  # reported by the law builds
        pass
    finally:
        subject.disturbed.extend(before.changed())
        before.restore()
    laws = [law for law in laws_of(subject.kind) if law.applies(subject)]
    if not laws:
        raise OptionError(f"there are no laws for a {subject.kind}")
    return laws


def judge(law: Law, subject: Subject) -> Result:
    """Test a component against one law.

    Any exception of the component is a failure. Process settings changed by the component are restored, so
    that later laws detect the change again.
    """
    start, before = time.perf_counter(), Snapshot()
    message = ""
    try:
        law.judge(subject)
    except Broken as error:
        message = str(error)
    except PLUGIN_FAILURES as error:
        message = (
            f"{type(error).__name__}: {error}: the component raised an error where the law requires an answer"
        )
    seconds = time.perf_counter() - start
    if before.changed():
        before.restore()
    return Result(law.name, law.sentence, not message, message, seconds, law.promise)
