"""Pytest interface: a conformance test in one line of a test file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from agglo_core.conformance.base import Subject, subject_of
from agglo_core.conformance.engine.judging import Result, judge, laws_for, report_once
from agglo_core.conformance.engine.runner import check
from agglo_core.conformance.laws import all_laws
from agglo_core.errors import AggloError, OptionError
from agglo_core.registry import Registry


def conformance(
    component: object,
    kind: str | None = None,
    *,
    xfail: Mapping[str, str] | None = None,
    options: Mapping[str, Any] | None = None,
    promises: Mapping[str, bool | float] | None = None,
    registry: Registry | None = None,
    thorough: bool = False,
    timeout: float | None = None,
) -> Callable[..., None]:
    """Make a pytest function that tests a component, with one test per law.

    The first test, ``is_found``, fails if the component cannot be used or no law applies.

    Parameters
    ----------
    component, kind, options, promises, registry, thorough, timeout
        As in :func:`check`. With a timeout, the first test judges all laws in a child process.
    xfail : mapping of law to reason, optional
        Laws known to fail. The marks are strict: a listed law that passes is a failure.

    Raises
    ------
    OptionError
        If ``xfail`` names a law that does not exist.

    Examples
    --------
    >>> from agglo_core.conformance import conformance
    >>> test_conformance = conformance("bisector:inertial")
    """
    import pytest

    excused = dict(xfail or {})
    # Errors found at import become failures of the test is_found, so that pytest can collect the file.
    if unknown := sorted(set(excused) - {law.name for law in all_laws()}):
        raise OptionError(f"xfail names {unknown[0]!r}, which is not a law")
    try:
        subject: Subject | None = replace(
            subject_of(component, kind, options=options, promises=promises, registry=registry),
            thorough=thorough,
        )
        problem = ""
    except AggloError as error:
        subject, problem = None, str(error)
    judged: list[Result] = []

    @cache
    def judge_in_child() -> Mapping[str, Result]:
        results = check(
            component, kind, timeout, options=options, promises=promises, registry=registry, thorough=thorough
        )
        return {result.law: result for result in results}

    def result_of(law: str) -> Result:
        if timeout is not None:
            results = judge_in_child()
            if law not in results:
                reasons = [result.message for result in results.values() if not result.passed]
                pytest.fail(f"the check ended before this law: {'; '.join(reasons) or 'no reason is known'}")
            return results[law]
        assert subject is not None
        judged.append(judge(laws[law], subject))
        return report_once(judged)[-1]

    laws = {law.name: law for law in laws_for(subject)} if subject else {}
    if idle := sorted(set(excused) - set(laws)):
        problem = problem or f"xfail names {idle[0]!r}, which does not apply here"
    parameters: list[Any] = ["is_found"]
    # Parametrise over the laws and mark the expected failures.
    for name in laws:
        marks = [pytest.mark.xfail(strict=True, reason=excused[name])] if name in excused else []
        parameters.append(pytest.param(name, marks=marks))

    @pytest.mark.parametrize("law", parameters)
    def test(law: str) -> None:
        if law == "is_found":
            assert not problem, problem
            assert laws, "no law applies to it"
            return
        assert subject is not None
        result = result_of(law)
        if result.state == "not run":
            pytest.skip(result.message)
        assert result.passed, f"{subject.title}: {law}: {result.message}\n\n{result.code}".rstrip()

    return test
