"""Search for installed plugins, and collection of the components and commands they declare.

Failures become reasons, not exceptions.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata

import pluggy

from agglo_core.registry.containment import LoadingError, contain_loading, printable, shown
from agglo_core.registry.declarations import Command, Component, Hooks
from agglo_core.suggestions import did_you_mean

GROUP = "agglo"
_HOOKS = tuple(name for name in vars(Hooks) if name.startswith("agglo_"))


@dataclass(frozen=True)
class Found:
    """An installed plugin that is not yet loaded: its name, entry point, distribution and version."""

    name: str
    entry_point: metadata.EntryPoint | None
    distribution: str
    version: str


def find_entry_points() -> Iterator[Found]:
    """Yield the installed plugins (entry points of the group ``agglo``), in the order of sys.path.

    ``importlib.metadata.entry_points`` would raise for a malformed file of any distribution.
    """
    keys = set()
    for distribution in metadata.distributions():
        try:
            text = distribution.read_text("entry_points.txt") or ""
        except ValueError:  # not UTF-8, hence no plugin of agglo
            continue
        name = printable(str(distribution.metadata["Name"])) if f"[{GROUP}]" in text else ""
        key = name.lower().replace("_", "-").replace(".", "-")
        if not name or key in keys:
            continue
        keys.add(key)
        version = str(distribution.metadata["Version"] or "")
        try:
            points = [point for point in distribution.entry_points if point.group == GROUP]
        except (TypeError, ValueError):  # a line without '='
            yield Found(name, None, name, version)
            continue
        for point in points:
            yield Found(printable(point.name), point, name, version)


def version_of(distribution: str) -> str:
    """Return an installed distribution's version, or ``0+unknown`` for a source tree."""
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "0+unknown"


def attach(manager: pluggy.PluginManager, plugin: object, key: str) -> tuple[list[Component | Command], str]:
    """Register a plugin's hooks, and collect the components and commands they declare.

    Return the declarations, and the reason if the plugin is broken (or ``""``).

    A broken plugin does not stay registered, so none of its hooks will be called.
    """
    if manager.is_registered(plugin):
        return [], f"the object is already registered as plugin {manager.get_name(plugin)!r}"
    try:
        with contain_loading(f"plugin {key}"):
            problem = _find_hook_fault(manager, plugin)
            if not problem:
                manager.register(plugin, key)
    except LoadingError as error:
        detach(manager, plugin)
        return [], f"its hooks cannot be registered: {error}"
    if problem:
        return [], problem
    declared, problem = _collect_declarations(manager, plugin, key)
    if problem:
        detach(manager, plugin)
    return declared, problem


def detach(manager: pluggy.PluginManager, plugin: object) -> None:
    """Unregister a plugin's hooks, if they are registered."""
    if manager.is_registered(plugin):
        manager.unregister(plugin)


def _find_hook_fault(manager: pluggy.PluginManager, plugin: object) -> str:
    """Return the reason why a plugin's hooks would never be called, or ``""`` if there is none.

    Reasons are a misspelt hook, a missing mark, or no hook at all.
    """
    n_hooks = 0
    for name in dir(plugin):
        marks = manager.parse_hookimpl_opts(plugin, name)
        if marks is None and not (name.startswith("agglo_") and inspect.isroutine(getattr(plugin, name))):
            continue
        hook = (marks and marks.get("specname")) or name
        if hook not in _HOOKS and not (marks and marks.get("optionalhook")):
            return f"unknown hook {hook!r}{did_you_mean(hook, _HOOKS)}; accepted: {', '.join(_HOOKS)}"
        if marks is None:
            return f"{hook} is not marked with @hookimpl (from agglo_core import hookimpl)"
        n_hooks += 1
    return "" if n_hooks else f"no hook is implemented; accepted: {', '.join(_HOOKS)}"


def _collect_declarations(
    manager: pluggy.PluginManager, plugin: object, key: str
) -> tuple[list[Component | Command], str]:
    """Call a plugin's hooks to collect the components and commands it declares.

    Return their declarations, and the first fault, or ``""``.
    """
    declarations: list[Component | Command] = []
    for hook, kind in (("agglo_components", Component), ("agglo_commands", Command)):
        for implementation in getattr(manager.hook, hook).get_hookimpls():
            if implementation.plugin is not plugin:
                continue
            try:
                with contain_loading(f"plugin {key}"):
                    answer = implementation.function()
            except LoadingError as error:
                return declarations, f"{hook}() raised {error}"
            if not isinstance(answer, list | tuple):
                return declarations, f"{hook}() returned {shown(answer)}, expected a list of {kind.__name__}"
            for position, item in enumerate(answer):
                if not isinstance(item, kind):
                    return declarations, f"{hook}()[{position}] is {shown(item)}, expected a {kind.__name__}"
                declarations.append(item)
    return declarations, ""
