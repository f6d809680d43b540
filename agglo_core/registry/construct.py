"""From a record to an object: import the target, check the options, build, check the methods."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Mapping
from functools import lru_cache, reduce
from importlib import import_module
from typing import Any

from agglo_core.errors import AggloError, OptionError, PluginError
from agglo_core.registry.discovery import PLUGIN_FAILURES, raised
from agglo_core.registry.records import Record, describe, unusable

__all__ = ["construct", "resolve"]

_ANY_OF = {
    "bisector": ("bisect", "bisect_level", "partition"),
    "refiner": ("refine",),
    "fixer": ("fix",),
    "metric": ("measure",),
    "solver": ("solve",),
}


def resolve(record: Record) -> Any:
    """Import and return the target of a record that is ok.

    Raises
    ------
    PluginError
        If the record is not ok, or its target cannot be imported.
    """
    if record.state != "ok":
        raise PluginError(f"{describe(record)} cannot be used: {unusable(record)}")
    declared = record.component or record.command
    if declared is None:
        raise PluginError(f"{describe(record)} declares nothing that could be built")
    module, _, attribute = declared.target.partition(":")
    try:
        return reduce(getattr, attribute.split("."), import_module(module))
    except PLUGIN_FAILURES as error:
        raise PluginError(
            f"{describe(record)}: importing its target {declared.target!r} raised {raised(error)}"
        ) from error


def construct(record: Record, options: Mapping[str, Any]) -> Any:
    """Build the component of a record with the given options.

    Raises
    ------
    PluginError
        If it is not ok, cannot be imported or built, or lacks a method of its kind.
    OptionError
        If an option is unknown or missing; whatever AggloError the constructor raises passes through.
    """
    target = resolve(record)
    if not callable(target):
        raise PluginError(f"{describe(record)}: its target is {target!r:.60}, expected a class or a factory")
    _check_options(record, target, options)
    try:
        built = target(**options)
    except AggloError:
        raise
    except PLUGIN_FAILURES as error:
        given = ", ".join(f"{name}={value!r}" for name, value in options.items()) or "no options"
        raise PluginError(f"{describe(record)} could not be built with {given}: {raised(error)}") from error
    _check_methods(record, built)
    return built


def _check_options(record: Record, target: Any, options: Mapping[str, Any]) -> None:
    parameters = _parameters(target) if isinstance(target, type) else _look_up(target)
    if parameters is None or any(p.kind is p.VAR_KEYWORD for p in parameters):
        return
    named = [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]
    accepted = [p.name for p in named]
    for name in options:
        if name not in accepted:
            close = difflib.get_close_matches(name, accepted, n=1)
            hint = f" (did you mean {close[0]!r}?)" if close else ""
            listed = ", ".join(accepted) or "none"
            raise OptionError(f"{describe(record)} has no option {name!r}{hint}; accepted: {listed}")
    lacking = [p.name for p in named if p.default is p.empty and p.name not in options]
    if lacking:
        raise OptionError(f"{describe(record)} needs a value for {', '.join(lacking)}")


def _look_up(target: Any) -> tuple[inspect.Parameter, ...] | None:
    """What a class or factory takes; None for one written in C that does not tell: it checks itself."""
    try:
        return tuple(inspect.signature(target).parameters.values())
    except (TypeError, ValueError):
        return None


@lru_cache(maxsize=256)
def _parameters(target: type) -> tuple[inspect.Parameter, ...] | None:
    return _look_up(target)  # takes longer than to build most components, so once for each class


def _check_methods(record: Record, built: Any) -> None:
    methods = _ANY_OF[record.kind]
    if not any(callable(getattr(built, method, None)) for method in methods):
        wanted = " or ".join(f"{method}(…)" for method in methods)
        raise PluginError(f"{describe(record)} built {built!r:.60}, which has no method {wanted}")
    if record.kind == "refiner" and not isinstance(getattr(built, "objective", None), str):
        raise PluginError(
            f"{describe(record)} built {built!r:.60}, which has no attribute 'objective' (a name)"
        )
