"""Pytest interface: a conformance test in one line of a test file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from agglo_core.conformance.base import Law, subject_of
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

    The first test, ``is_found``, fails if the component cannot be used.

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

    arguments: dict[str, Any] = {"options": options, "promises": promises, "registry": registry}
    excused = dict(xfail or {})
    if unknown := sorted(set(excused) - {law.name for law in all_laws()}):
        raise OptionError(f"xfail names {unknown[0]!r}, which is not a law")
    # Errors found at import become failures of the test is_found, so that pytest can collect the file.
    laws: dict[str, Law] = {}
    try:
        subject = replace(subject_of(component, kind, **arguments), thorough=thorough)
        laws = {law.name: law for law in laws_for(subject)}
        idle = sorted(set(excused) - set(laws))
        problem = f"xfail names {idle[0]!r}, which does not apply here" if idle else ""
    except AggloError as error:
        problem = str(error)
    judged: list[Result] = []

    def result_of(law: str) -> Result:
        if timeout is None:
            judged.append(judge(laws[law], subject))
            return report_once(judged)[-1]
        judged[:] = judged or check(component, kind, timeout, **arguments, thorough=thorough)
        if found := [result for result in judged if result.law == law]:
            return found[0]
        reasons = "; ".join(result.message for result in judged if not result.passed)
        pytest.fail(f"the check ended before this law: {reasons or 'no reason is known'}")

    parameters: list[Any] = ["is_found"]
    for name in laws:
        marks = [pytest.mark.xfail(strict=True, reason=excused[name])] if name in excused else []
        parameters.append(pytest.param(name, marks=marks))

    @pytest.mark.parametrize("law", parameters)
    def test(law: str) -> None:
        if law == "is_found":
            assert not problem, problem
            return
        result = result_of(law)
        if result.state == "not run":
            pytest.skip(result.message)
        assert result.passed, f"{subject.title}: {law}: {result.message}\n\n{result.code}".rstrip()

    return test
