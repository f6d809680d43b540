"""Judging a component by the laws of its kind; the answer is data."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from agglo_core.conformance.law import Broken, Law
from agglo_core.conformance.laws import all_laws
from agglo_core.conformance.subject import Subject, subject_of
from agglo_core.errors import OptionError
from agglo_core.registry.discovery import PLUGIN_FAILURES

__all__ = ["Result", "check", "judge", "laws_for"]


@dataclass(frozen=True)
class Result:
    """How a component stands to one law.

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
        The promise that brought the law.
    """

    law: str
    sentence: str
    passed: bool
    message: str
    seconds: float
    promise: str | None = None


def check(
    component: object,
    kind: str | None = None,
    timeout: float | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    promises: Mapping[str, bool | float] | None = None,
) -> list[Result]:
    """Judge a component by every law that applies to it; never stops at the first failure.

    Parameters
    ----------
    component : str, Component, class or object
        A name (``"mine"``, ``"bisector:mine"``, ``"plugin/mine"``), a declaration, a class, or an object.
    kind : str, optional
        Where the name does not tell.
    timeout : float, optional
        Seconds a law may take: the laws then run in another process, which is stopped. Not for objects.
    options : mapping, optional
        The component's options.
    promises : mapping, optional
        Instead of the declared ones.

    Raises
    ------
    PluginError, OptionError
        If there is no such component, or it cannot be used at all.

    Examples
    --------
    >>> from agglo_core.conformance import check
    >>> all(result.passed for result in check("metric:cells"))
    True
    """
    subject = subject_of(component, kind, options=options, promises=promises)
    if timeout is None:
        return [judge(law, subject) for law in laws_for(subject)]
    if not timeout > 0:
        raise OptionError(f"timeout must be positive, given {timeout}")
    from agglo_core.conformance.isolation import judge_apart

    return judge_apart(subject, timeout)


def laws_for(subject: Subject) -> Sequence[Law]:
    """The laws that apply, in order; never none.

    Raises
    ------
    OptionError
        If it cannot be built for want of an option.
    """
    try:
        subject.make()
    except OptionError:
        raise
    except PLUGIN_FAILURES:  # the law builds reports it
        pass
    chosen = [law for law in all_laws() if law.applies(subject)]
    if not chosen:
        raise OptionError(f"there are no laws for a {subject.kind}")
    return chosen


def judge(law: Law, subject: Subject) -> Result:
    """The result of one law; whatever the component raises is a failure."""
    start = time.perf_counter()
    message = ""
    try:
        law.judge(subject)
    except Broken as error:
        message = str(error)
    except PLUGIN_FAILURES as error:
        message = f"{type(error).__name__}: {error}: the component raised where the law asks for an answer"
    seconds = time.perf_counter() - start
    return Result(law.name, law.sentence, not message, message, seconds, law.promise)
