"""Test a component against the laws of its kind, and return the results as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from agglo_core.conformance.base import subject_of
from agglo_core.conformance.engine.isolation import judge_apart
from agglo_core.conformance.engine.judging import Result, judge, laws_for, report_once
from agglo_core.errors import OptionError
from agglo_core.registry import Registry


def check(
    component: object,
    kind: str | None = None,
    timeout: float | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    promises: Mapping[str, bool | float] | None = None,
    registry: Registry | None = None,
    thorough: bool = False,
    laws: Sequence[str] = (),
) -> list[Result]:
    """Test a component against every law that applies, without stopping at a failure.

    Parameters
    ----------
    component : str, Component, class or object
        A name (``"mine"``, ``"bisector:mine"``, ``"plugin/mine"``), a declaration, a class, or an object;
        for ``kind="sample"`` also a function.
    kind : str, optional
        Component kind, needed if the name is ambiguous.
    timeout : float, optional
        Maximum CPU seconds per law. The laws then run in a child process, which is stopped at a timeout, or
        if it waits that long for something that never comes. Not available for objects.
    options : mapping, optional
        Component options.
    promises : mapping, optional
        Promises that replace the declared promises.
    registry : Registry, optional
        Registry for names; by default the installed plugins. With a timeout, the child process receives
        only the component and not the rest of the registry.
    thorough : bool
        Judge the laws on large meshes as well.
    laws : sequence of str
        Names of the laws to judge; by default all that apply.

    Returns
    -------
    list of Result
        One result for each law, in the order of testing. Failures of one cause say so after the first.

    Raises
    ------
    PluginError, OptionError
        If the component does not exist or cannot be used, or a law does not apply to it.

    Examples
    --------
    >>> from agglo_core.conformance import check
    >>> all(result.passed for result in check("metric:cells", laws=["answers", "within_bounds"]))
    True
    """
    subject = subject_of(component, kind, options=options, promises=promises, registry=registry)
    subject = replace(subject, thorough=thorough)
    if timeout is None:
        return report_once([judge(law, subject) for law in laws_for(subject, laws)])
    if not timeout > 0:
        raise OptionError(f"timeout must be positive, given {timeout}")
    return report_once(judge_apart(subject, timeout, laws))
