"""Select the laws that apply to a component, and test the component against them."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from agglo_core.conformance.base import ATTRIBUTES, Broken, Law, Subject
from agglo_core.conformance.base.surroundings import Snapshot
from agglo_core.conformance.base.tracing import component_frame
from agglo_core.conformance.laws import laws_of
from agglo_core.errors import OptionError
from agglo_core.registry.containment import PLUGIN_FAILURES
from agglo_core.suggestions import did_you_mean

State = Literal["ok", "FAILS", "not run", "suite error"]


@dataclass(frozen=True)
class Result:
    """Result of testing a component against one law.

    Attributes
    ----------
    law, sentence : str
        Law name and statement.
    state : str
        ``ok``; ``FAILS``; ``not run``, if the component was stopped before; or ``suite error``, if the suite
        raised an exception that did not come from the component.
    message : str
        Fault and remedy; empty if the law holds.
    seconds : float
        CPU seconds of the process.
    promise : str or None
        Promise that switched the law on.
    cause : str
        Key of the cause of a failure. Failures of one cause have equal keys; empty if there is no other.
    code : str
        Lines of Python that make the smallest input found that breaks the law, if inputs are drawn.

    Examples
    --------
    >>> from agglo_core.split.geometric import InertialBisection
    >>> from agglo_core.conformance import check
    >>> first = check(InertialBisection(), laws=["builds"])[0]
    >>> first.law, first.passed, first.message
    ('builds', True, '')
    """

    law: str
    sentence: str
    state: State
    message: str
    seconds: float
    promise: str | None = None
    cause: str = ""
    code: str = ""

    @property
    def passed(self) -> bool:
        """True if the component obeys the law."""
        return self.state == "ok"


def laws_for(subject: Subject, names: Iterable[str] = ()) -> Sequence[Law]:
    """Return the laws that apply to the component under test, in the order of testing.

    With ``names``, only these laws. Of a component that cannot be built, only ``builds`` is judged. The list
    is never empty.

    Raises
    ------
    OptionError
        If the component cannot be built without an option, its kind has no laws, or a law does not apply.
    """
    before, built = Snapshot(), True
    try:
        subject.make()
    except OptionError:
        raise
    except PLUGIN_FAILURES:
        built = False
    finally:
        subject.disturbed.extend(before.changed())
        before.restore()
    laws = [law for law in laws_of(subject.kind) if law.applies(subject)]
    if not laws:
        raise OptionError(f"there are no laws for a {subject.kind}")
    chosen, applicable = list(names), {law.name: law for law in laws}
    for name in chosen:
        if name not in applicable:
            raise OptionError(
                f"no law for this {subject.kind} is named {name!r}{did_you_mean(name, applicable)}; "
                f"applicable: {', '.join(applicable)}"
            )
    if not built:
        chosen = ["builds"]
    return [law for law in laws if not chosen or law.name in chosen]


def judge(law: Law, subject: Subject) -> Result:
    """Test a component against one law.

    Any exception of the component is a failure; an exception of the suite is a suite error. Process settings
    changed by the component are restored, so that later laws detect the change again.
    """
    start, before = time.process_time(), Snapshot()
    state: State = "ok"
    message, cause, code = "", "", ""
    try:
        law.judge(subject)
    except Broken as error:
        state, message, code = "FAILS", str(error), error.code
        cause = _cause(subject, error)
    except PLUGIN_FAILURES as error:
        state, message, cause = _blame(subject, error)
    seconds = time.process_time() - start
    if before.changed():
        before.restore()
    return Result(law.name, law.sentence, state, message, seconds, law.promise, cause, code)


def report_once(results: Sequence[Result]) -> list[Result]:
    """Replace the message of each failure whose cause an earlier failure has reported."""
    first: dict[str, str] = {}
    reported = []
    for result in results:
        law = first.setdefault(result.cause, result.law) if result.state == "FAILS" and result.cause else ""
        repeated = bool(law) and law != result.law
        reported.append(
            replace(result, message=f"the same fault as in {law}", code="") if repeated else result
        )
    return reported


def _cause(subject: Subject, error: BaseException) -> str:
    """Return the key of a failure's cause: as given, or the component's line that raised it."""
    chain: BaseException | None = error
    while chain is not None:
        key = chain.cause if isinstance(chain, Broken) else _place(subject, chain)
        if key:
            return key
        chain = chain.__cause__
    return ""


def _blame(subject: Subject, error: BaseException) -> tuple[State, str, str]:
    """Return state, message and cause for an exception that a law did not expect."""
    text = f"{type(error).__name__}: {error}"
    if isinstance(error, AttributeError) and _is_component(subject, error.obj):
        return "FAILS", f"it has no attribute {error.name!r}, which its kind requires", ATTRIBUTES
    if place := _place(subject, error):
        return "FAILS", f"{text} ({place}): the component raised an error where an answer is required", place
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return (
        "suite error",
        f"{text} ({frame.filename}:{frame.lineno}): the suite failed, perhaps on an answer of a form that it "
        "does not expect; please report it",
        "",
    )


def _is_component(subject: Subject, value: object) -> bool:
    """Return True if a value is the component under test, its class, or built from this class."""
    target = subject.target
    return value is target or isinstance(value, target if isinstance(target, type) else type(target))


def _place(subject: Subject, error: BaseException) -> str:
    """Return type and last line of an exception in the component's code, or an empty string outside."""
    frame = component_frame(subject, error)
    return f"{type(error).__name__} at {frame.filename}:{frame.lineno}" if frame else ""
