"""Judging a component by the laws of its kind; the results are data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from agglo_core.conformance.base.subject import subject_of
from agglo_core.conformance.engine.isolation import judge_apart
from agglo_core.conformance.engine.judging import Result, judge, laws_for
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
) -> list[Result]:
    """Judge a component by every law that applies to it; never stops at the first failure.

    Parameters
    ----------
    component : str, Component, class or object
        A name (``"mine"``, ``"bisector:mine"``, ``"plugin/mine"``), a declaration, a class, or an object;
        for ``kind="sample"`` also a function.
    kind : str, optional
        Where the name does not tell.
    timeout : float, optional
        Seconds a law may take: the laws then run in another process, which is stopped. Not for objects.
    options : mapping, optional
        The component's options.
    promises : mapping, optional
        Instead of the declared ones.
    registry : Registry, optional
        Where names are looked up; by default the installed plugins. With a timeout the other
        process is given the component alone and does not know the rest of the registry.

    thorough : bool
        Ask the laws of large meshes too.

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
    subject = subject_of(component, kind, options=options, promises=promises, registry=registry)
    subject = replace(subject, thorough=thorough)
    if timeout is None:
        return [judge(law, subject) for law in laws_for(subject)]
    if not timeout > 0:
        raise OptionError(f"timeout must be positive, given {timeout}")
    return judge_apart(subject, timeout)
