"""Construction of a component: class import, option check, call, result check."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from functools import reduce
from importlib import import_module
from typing import Any

from agglo_core.errors import AggloError, OptionError, PluginError
from agglo_core.registry.containment import (
    PLUGIN_FAILURES,
    LoadingError,
    contain_loading,
    describe_error,
    restore_folder,
    shown,
)
from agglo_core.registry.kinds import KINDS
from agglo_core.registry.option_types import Text, parse_value
from agglo_core.registry.options import convert, options_of, wants_registry
from agglo_core.registry.records import Record, describe, unusable
from agglo_core.suggestions import did_you_mean


def resolve(record: Record) -> Any:
    """Import the class, factory or command of a usable record, and return it.

    Raises
    ------
    PluginError
        If the record is not ok, or its target cannot be imported.
    """
    if record.state != "ok":
        raise PluginError(f"{describe(record)} cannot be used: {unusable(record)}")
    declared = record.component or record.command
    if declared is None:
        raise PluginError(f"{describe(record)} declares no target to build")
    module, _, attribute = declared.target.partition(":")
    target = vars(sys.modules[module]).get(attribute) if module in sys.modules else None
    if target is not None:  # usually already imported: no plugin code runs
        return target
    try:
        with contain_loading(describe(record)):
            return reduce(getattr, attribute.split("."), import_module(module))
    except LoadingError as error:
        raise PluginError(
            f"{describe(record)}: importing its target {declared.target!r} raised {error}"
        ) from error.__cause__


def construct(record: Record, options: Mapping[str, Any], registry: object = None) -> Any:
    """Build the component that a record describes, with the given options.

    ``registry`` is passed to targets with this parameter.

    Raises
    ------
    PluginError
        If the record is not ok, or its component cannot be imported or built, or lacks a method of its kind.
    OptionError
        If an option is unknown or missing; other AggloErrors of the constructor pass unchanged.
    """
    target = resolve(record)
    if not callable(target):
        raise PluginError(f"{describe(record)}: its target is {shown(target)}, expected a class or a factory")
    arguments = check_options(record, target, options)
    try:
        with restore_folder(describe(record)):
            built = target(**arguments, **({"registry": registry} if wants_registry(target) else {}))
    except AggloError:
        raise
    except PLUGIN_FAILURES as error:
        text = ", ".join(f"{name}={shown(value)}" for name, value in arguments.items()) or "no options"
        raise PluginError(
            f"{describe(record)} could not be built with {text}: {describe_error(error)}"
        ) from error
    _check_built(record, built)
    return built


def check_options(
    record: Record, target: Any, options: Mapping[str, Any], also: Iterable[str] = ()
) -> dict[str, Any]:
    """Check a component's options, and convert them to the declared types.

    ``also`` are further names for the suggestion, such as the keywords of a function that passes options on.

    Raises
    ------
    OptionError
        If an option is unknown, missing or of another type, with the accepted options.
    """
    parameters = options_of(target)
    if parameters is None:
        return {name: parse_value(v) if isinstance(v, Text) else v for name, v in options.items()}
    accepted = {option.name: option for option in parameters}
    for name in options:
        if name not in accepted:
            hint = did_you_mean(name, [*accepted, *also])
            listed = ", ".join(accepted) or "none"
            raise OptionError(f"{describe(record)} has no option {name!r}{hint}; accepted: {listed}")
    lacking = [option.name for option in parameters if option.required and option.name not in options]
    if lacking:
        raise OptionError(f"{describe(record)} needs a value for {', '.join(lacking)}")
    return {name: convert(accepted[name], value, describe(record)) for name, value in options.items()}


def _check_built(record: Record, built: Any) -> None:
    """Raise PluginError unless a built object has the methods and attributes that its kind requires."""
    kind = KINDS[record.kind]
    if kind.methods and not any(callable(getattr(built, method, None)) for method in kind.methods):
        expected = " or ".join(f"{method}(…)" for method in kind.methods)
        raise PluginError(
            f"{describe(record)} built {shown(built)}, expected an object with a method {expected}"
        )
    for name, type_ in kind.attributes.items():
        try:
            value = getattr(built, name, None)
        except PLUGIN_FAILURES as error:  # a property of the plugin
            raise PluginError(
                f"{describe(record)}: its attribute {name!r} raised {describe_error(error)}"
            ) from error
        if not isinstance(value, type_):
            wrong = f"no attribute {name!r}" if value is None else f"{name} = {shown(value)}"
            raise PluginError(
                f"{describe(record)} built {shown(built)}, which has {wrong}; expected a {type_.__name__}"
            )
