"""Registry class: loads plugins, lists their components and commands, and builds components."""

from __future__ import annotations

import logging
import os
import sys
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import chain
from typing import Any

import pluggy

from agglo_core.errors import PluginError
from agglo_core.registry.construct import construct
from agglo_core.registry.containment import LoadingError, contain_loading
from agglo_core.registry.declarations import Command, Component, Hooks, faults, make_plain
from agglo_core.registry.discovery import Found, attach, detach, find_entry_points
from agglo_core.registry.kinds import KINDS
from agglo_core.registry.records import Installed, Record, describe, with_conflicts, with_requirements
from agglo_core.suggestions import did_you_mean

Records = list[Record]
Declared = list[Component | Command]


@dataclass(frozen=True, eq=False)
class _Plugin:
    """A plugin, loaded or failed: its module or object, and one record per declared component or command."""

    name: str
    distribution: str
    plugin: object
    records: tuple[Record, ...]

    @cached_property
    def named(self) -> Mapping[tuple[str, str], Records]:
        """Records of the plugin by kind and name, stored because each run looks them up."""
        by_name: dict[tuple[str, str], Records] = defaultdict(list)
        for record in self.records:
            by_name[record.kind, record.name].append(record)
        return dict(by_name)


class Registry:
    """Table of all components and commands by name, with their states (usable, broken, …).

    States are computed on access, so that the registration order does not matter.

    Attributes
    ----------
    hook : pluggy.HookRelay
        The hooks themselves; :meth:`level_done` calls the watchers separately.

    Examples
    --------
    >>> registry = agglo.Registry()
    >>> registry.discover()
    >>> "kmeans" in {record.name for record in registry.list()}
    True
    """

    def __init__(self) -> None:
        self._manager = pluggy.PluginManager("agglo")
        self._manager.add_hookspecs(Hooks)
        self._plugins: list[_Plugin] = []
        self._blocked: dict[str, str] = {}
        self.hook = self._manager.hook

    def register(self, plugin: object, name: str, *, distribution: str = "", version: str = "") -> None:
        """Add a plugin: a module or object whose hooks declare components or commands.

        A broken plugin is listed with the reason.

        Raises
        ------
        PluginError
            If a plugin with this name and distribution is already registered.
        """
        if any(p.name == name and p.distribution == distribution for p in self._plugins):
            raise PluginError(f"a plugin {name!r} is already registered; unregister it first")
        origin = Record(None, name, distribution, version)
        if name in self._blocked:
            self._add(origin, plugin, [], self._blocked[name])
            return
        declared, problem = attach(self._manager, plugin, f"{name} ({distribution or 'by hand'})")
        self._add(origin, plugin, declared, problem)

    def unregister(self, name: str) -> None:
        """Remove every plugin with this name, in any state."""
        leaving = [p for p in self._plugins if p.name == name]
        if not leaving:
            raise PluginError(f"no plugin {name!r} is registered; registered: {self._names()}")
        for plugin in leaving:
            detach(self._manager, plugin.plugin)
            self._plugins.remove(plugin)

    def block(self, name: str, reason: str = "blocked by the program") -> None:
        """Make a plugin unusable, even if it is registered later."""
        self._blocked[name] = reason
        for plugin in self._plugins:
            if plugin.name == name:
                detach(self._manager, plugin.plugin)

    def records(self) -> Records:
        """Return records for all components, failed plugins and commands, with their states.

        This method never fails.
        """
        return sorted(self._records(), key=lambda record: record.command is not None)

    def list(self, kind: str | None = None) -> Records:
        """List all components and all failed plugins, with their states.

        This method never fails.

        With a kind, only components of that kind are listed.
        """
        return [record for record in self._records(kind) if record.command is None]

    def commands(self) -> Records:
        """List all plugins' commands, with their states."""
        return [record for record in self._records() if record.command is not None]

    def build(self, kind: str, name: str, /, **options: Any) -> Any:
        """Build a component from its kind, name and options.

        ``name`` may be qualified as ``plugin/name`` (or ``distribution/name``).

        Raises
        ------
        PluginError
            For an unknown, unusable or faulty component, with its plugin, distribution and version.
        OptionError
            If an option is not accepted, with the accepted options.
        """
        return self.assemble(self.record(kind, name), options)

    def assemble(self, record: Record, options: Mapping[str, Any]) -> Any:
        """Build the component that a record of this registry describes.

        Raises as :meth:`build`.
        """
        self._manager.trace.root.get("build")(describe(record), dict(options))
        return construct(record, options, self)

    def record(self, kind: str, name: str) -> Record:
        """Return the record of a component or command by its name, usable or not.

        ``kind`` may also be ``"command"``.

        Raises
        ------
        PluginError
            If there is none, with the available names and the closest match.
        """
        if kind not in (*KINDS, "command"):
            raise PluginError(f"unknown kind of component {kind!r}; expected one of {', '.join(KINDS)}")
        qualifier, _, base_name = name.rpartition("/")
        records = self._records(kind, base_name, resolved=not qualifier)
        if qualifier:
            records = [r for r in records if qualifier in (r.plugin, r.distribution)]
            records = [r for r in records if r.in_tree] or records
        candidates = [r for r in records if r.declared] or records
        if len(candidates) > 1 and qualifier:
            raise PluginError(
                f"{kind} {name!r} is ambiguous: {' or '.join(map(describe, candidates))}; unregister one"
            )
        if candidates:
            return candidates[0]
        raise PluginError(self._unknown(kind, name))

    def declares(self, kind: str, name: str) -> bool:
        """Return True if a component with this name is declared, usable or not (called at each run)."""
        return any((kind, name) in plugin.named for plugin in self._plugins)

    def level_done(self, info: Mapping[str, Any]) -> None:
        """Report a finished depth of the recursion to every plugin that observes runs.

        A plugin that raises is reported in a warning and not called again, because an observer must not end a
        run.
        """
        self._manager.trace.root.get("level")(dict(info))
        for watcher in self.hook.agglo_level_done.get_hookimpls():
            try:
                with contain_loading(f"plugin {watcher.plugin_name!r}"):
                    watcher.function(*(info for _ in watcher.argnames))
            except LoadingError as error:
                message = "plugin %r is not called any more: agglo_level_done() raised %s"
                logging.getLogger("agglo").warning(message, watcher.plugin_name, error)
                detach(self._manager, watcher.plugin)

    def discover(self, environ: Mapping[str, str] = os.environ) -> None:
        """Load all installed plugins except those excluded by ``AGGLO_BLOCK`` or ``AGGLO_ONLY``."""
        if environ.get("AGGLO_TRACE"):
            self._manager.trace.root.setwriter(sys.stderr.write)
            self._manager.enable_tracing()
        blocked, only = _names(environ, "AGGLO_BLOCK"), _names(environ, "AGGLO_ONLY")
        entries = list(find_entry_points())
        names = {entry.name for entry in entries}
        for unknown in sorted((blocked | only) - names):
            logging.getLogger("agglo").warning(
                "AGGLO_BLOCK or AGGLO_ONLY lists %r, which is not an installed plugin", unknown
            )
        for name in sorted(names):
            if name in blocked:
                self.block(name, "blocked by AGGLO_BLOCK")
            elif only and name not in only:
                self.block(name, "not listed in AGGLO_ONLY")
        for entry in entries:
            self._load(entry)

    def _load(self, entry: Found) -> None:
        """Import an installed plugin and store its component and command records.

        A failure is stored as the reason why the plugin is broken.

        Failures become their reason.
        """
        trace, point = self._manager.trace.root, entry.entry_point
        trace.get("load")(entry.name, entry.distribution, entry.version)
        origin = Record(None, entry.name, entry.distribution, entry.version)
        if entry.name in self._blocked:
            self._add(origin, None, [], self._blocked[entry.name])
            return
        if point is None:
            self._add(origin, None, [], "the entry_points.txt of its distribution is malformed")
            return
        key, start = f"{entry.name} ({entry.distribution})", time.perf_counter()
        try:
            with contain_loading(f"plugin {key}"):
                plugin = point.load()
        except LoadingError as error:
            trace.get("failed")(traceback.format_exc())
            self._add(origin, None, [], f"importing {point.value!r} raised {error}")
            return
        declared, problem = attach(self._manager, plugin, key)
        origin = replace(origin, import_seconds=time.perf_counter() - start)
        self._add(origin, plugin, declared, problem)

    def _add(self, origin: Record, plugin: object, declared: Declared, problem: str) -> None:
        """Store records for the components and commands that a plugin declares.

        Faulty records, or all in case of a ``problem``, are broken.
        """
        all_faults = [list(faults(item)) for item in declared]
        sound = [
            make_plain(item) if item_faults else item
            for item, item_faults in zip(declared, all_faults, strict=True)
        ]
        records = [_record_of(origin, item) for item in sound]
        times = Counter(f"{r.kind} {r.name}" for r in records)
        for place, (record, item_faults) in enumerate(zip(records, all_faults, strict=True)):
            if times[f"{record.kind} {record.name}"] > 1:
                item_faults.append(f"{record.kind} {record.name!r} is declared more than once by this plugin")
            if reason := problem or "; ".join(item_faults):
                records[place] = replace(record, state="broken", reason=reason)
        if problem and not records:
            records.append(replace(origin, state="broken", reason=problem))
        self._plugins.append(_Plugin(origin.plugin, origin.distribution, plugin, tuple(records)))

    def _records(self, kind: str | None = None, name: str | None = None, *, resolved: bool = True) -> Records:
        """Return records with their states: all, those of one kind, or those of a kind and a name."""
        candidates: Iterable[Record]
        if name is not None:
            candidates = chain.from_iterable(
                plugin.named.get((str(kind), name), ()) for plugin in self._plugins
            )
        else:
            candidates = chain.from_iterable(plugin.records for plugin in self._plugins)
            candidates = (record for record in candidates if kind in (None, record.kind))
        installed = Installed()
        records = [with_requirements(self._unblocked(record), installed) for record in candidates]
        return with_conflicts(records) if resolved else records

    def _unblocked(self, record: Record) -> Record:
        reason = self._blocked.get(record.plugin)
        return record if reason is None else replace(record, state="blocked", reason=reason)

    def _names(self) -> str:
        return ", ".join(sorted({plugin.name for plugin in self._plugins})) or "none"

    def _unknown(self, kind: str, name: str) -> str:
        """Return the error message for an unknown name, with the closest match and the available names."""
        records = self._records()
        states = {r.name: "" if r.state == "ok" else f" ({r.state})" for r in records if r.kind == kind}
        available = ", ".join(f"{component}{state}" for component, state in sorted(states.items())) or "none"
        # A component of this name but of another kind is listed too, because its kind may be misspelt.
        broken = [r for r in records if r.kind == "plugin" or (r.name == name and r.state == "broken")]
        failures = "; ".join(f"{describe(r)}: {r.reason}" for r in broken)
        return f"no {kind} is named {name!r}{did_you_mean(name, states)}; available: {available}" + (
            f"; plugins that cannot be used: {failures}" if failures else ""
        )


def _record_of(origin: Record, declared: Component | Command) -> Record:
    if isinstance(declared, Component):
        return replace(origin, component=declared)
    return replace(origin, command=declared)


def _names(environ: Mapping[str, str], variable: str) -> set[str]:
    return {name.strip() for name in environ.get(variable, "").split(",") if name.strip()}


@cache
def default() -> Registry:
    """Return the registry of this process. On first use it loads the installed plugins.

    Examples
    --------
    >>> from agglo_core.registry import default
    >>> [record.name for record in default().list() if record.kind == "fixer"]
    ['connectivity']
    """
    registry = Registry()
    registry.discover()
    return registry
