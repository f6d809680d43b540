"""Component under test: its declaration, promises and options, and its construction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from agglo_core.conformance.base.asking import for_target
from agglo_core.conformance.base.verdict import Broken
from agglo_core.errors import OptionError, PluginError
from agglo_core.protocols import Target
from agglo_core.registry import KINDS, Component, Record, Registry, default, describe
from agglo_core.registry.construct import construct, resolve
from agglo_core.registry.containment import PLUGIN_FAILURES
from agglo_core.registry.declarations import faults
from agglo_core.registry.kinds import kind_of_methods
from agglo_core.registry.options import wants_registry
from agglo_core.registry.records import unusable
from agglo_core.suggestions import did_you_mean


@dataclass(frozen=True)
class Subject:
    """Component under test, with its declaration, promises and options.

    Attributes
    ----------
    kind, title : str
        Kind of component, and its description for messages.
    record : Record or None
        Declaration; None for a bare class or object.
    given : class or object, optional
        Class or object under test if there is no declaration.
    options : mapping
        Constructor options.
    declared : mapping
        Promises.
    registry : Registry, optional
        Registry for names; by default the installed plugins.
    cache : dict
        Refused cases, and the measured speed: some components take a second per case.
    thorough : bool
        Judge slow laws as well.
    draws : int
        Maximum number of drawn cases for each law.
    disturbed : list of str
        Process settings changed by building the component.
    goal : Target, optional
        If set, the bisector under test is the result of ``for_target`` for this target.
    """

    kind: str
    title: str
    record: Record | None = None
    given: Any = None
    options: Mapping[str, Any] = field(default_factory=dict)
    declared: Mapping[str, bool | float] = field(default_factory=dict)
    registry: Registry | None = None
    cache: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)
    thorough: bool = False
    draws: int = 1000
    disturbed: list[str] = field(default_factory=list, compare=False, repr=False)
    goal: Target | None = None

    def build(self) -> Any:
        """Build the component with its options, or return the object given for the test.

        Raises
        ------
        Broken
            If the component cannot be built.
        """
        try:
            tool = self.make()
        except PLUGIN_FAILURES as error:
            raise Broken("it cannot be built: see the law builds") from error
        return tool if self.goal is None else for_target(tool, self.goal)

    def make(self, **extra_options: Any) -> Any:
        """Build the component with additional or replaced options.

        Exceptions of the constructor propagate. A class of problems is returned itself: problems are made
        from tables and meshes, not from options.
        """
        if self._is_class_of_problems:
            return self.target
        if self.record is not None:
            return construct(self.record, {**self.options, **extra_options}, self.registry)
        if not self.takes_options:
            return self.given
        registry_option = {"registry": self.registry} if wants_registry(self.given) else {}
        return self.given(**{**self.options, **extra_options}, **registry_option)

    def problem(self, kind: str) -> Any:
        """Return the problem kind with this name in the registry: a class, or the result of a factory."""
        return Subject("problem", kind, self.lookup.record("problem", kind), registry=self.registry).make()

    def metric(self, name: str) -> Any:
        """Build the metric with this name, or return None if the registry does not contain it."""
        names = {record.name for record in self.lookup.list() if record.kind == "metric"}
        return self.lookup.build("metric", name) if name.rpartition("/")[2] in names else None

    @property
    def takes_options(self) -> bool:
        """Return True if the component is built from options: neither an object nor a class of problems."""
        if self._is_class_of_problems:
            return False
        return self.record is not None or isinstance(self.given, type) or self.kind == "sample"

    @property
    def target(self) -> Any:
        """Class or function that builds the component, or the object under test."""
        return resolve(self.record) if self.record is not None else self.given

    @property
    def lookup(self) -> Registry:
        """Registry in which component names are found."""
        return default() if self.registry is None else self.registry

    @property
    def _is_class_of_problems(self) -> bool:
        return self.kind == "problem" and isinstance(self.target, type)

    @property
    def name(self) -> str:
        """Name in the declaration, or an empty string without declaration."""
        return self.record.name if self.record else ""

    @property
    def fallback(self) -> str | None:
        """Name of the declared fallback: the bisector used if this bisector leaves a side empty."""
        return self.record.component.fallback if self.record and self.record.component else None

    @property
    def suffixes(self) -> Any:
        """A format's file suffixes, as declared, or otherwise from its attribute ``suffixes``."""
        declared = self.record.component.suffixes if self.record and self.record.component else ()
        return declared or getattr(self.build(), "suffixes", ())

    def promised(self, promise: str) -> bool | float | None:
        """Return the value of a promise, or None if the promise is missing or False."""
        value = self.declared.get(promise)
        return None if value is False else value

    @property
    def partitions(self) -> bool:
        """Return True for a bisector with a method for direct k-way partitions."""
        return self.kind == "bisector" and self.has("partition")

    def has(self, method: str) -> bool:
        """Return True if the component has this method, or cannot be built.

        Another law reports a component that cannot be built.
        """
        try:
            return callable(getattr(self.build(), method, None))
        except Broken:
            return True


def subject_of(
    component: object,
    kind: str | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    promises: Mapping[str, bool | float] | None = None,
    registry: Registry | None = None,
) -> Subject:
    """Make a component under test from its name, declaration, class or object.

    Names are written ``"mine"`` or ``"bisector:mine"``.

    Raises
    ------
    PluginError
        If no component has this name, or if the component cannot be used.
    OptionError
        If the kind is unknown or ambiguous, or options are given for an object.
    """
    record, option_values = None, dict(options or {})
    if isinstance(component, str):
        record = find(component, kind, registry)
        if record.state != "ok":
            raise PluginError(f"{describe(record)} cannot be used: {unusable(record)}")
    elif isinstance(component, Component):
        if wrong := "; ".join(faults(component)):
            raise PluginError(f"{component.kind} {component.name!r} is not declared well: {wrong}")
        record = Record(component, component.name)
    if record is not None:
        promises = promises or (record.component.promises if record.component else {})
        return Subject(record.kind, describe(record), record, None, option_values, promises, registry)
    # Without a declaration, the methods decide the kind.
    sort = kind or kind_of_methods(component)
    if sort is None:
        methods = ", ".join(method for entry in KINDS.values() for method in entry.methods)
        raise OptionError(f"{component!r:.60} is not a component: it has none of the methods {methods}")
    title = f"{sort} {getattr(component, '__name__', type(component).__name__)}"
    subject = Subject(sort, title, None, component, option_values, promises or {}, registry)
    if options and not subject.takes_options:
        raise OptionError(
            f"{component!r:.60} is already an object: options can only be passed with a name or a class"
        )
    return subject


def find(text: str, kind: str | None = None, registry: Registry | None = None) -> Record:
    """Return the registry record for ``"name"`` or ``"plugin/name"``, with an optional prefix ``"kind:"``."""
    lookup = default() if registry is None else registry
    # An explicit kind decides.
    before, colon, after = text.partition(":")
    if colon:
        return lookup.record(before, after)
    if kind:
        return lookup.record(kind, text)
    # Otherwise the name must belong to a single kind.
    base_name = text.rpartition("/")[2]
    kinds = sorted({record.kind for record in lookup.list() if record.name == base_name} & set(KINDS))
    if len(kinds) == 1:
        return lookup.record(kinds[0], text)
    if kinds:
        raise OptionError(f"{text!r} is the name of a {' and a '.join(kinds)}: write {kinds[0]}:{text}")
    broken = [record for record in lookup.list() if record.name == base_name and record.state == "broken"]
    if broken:  # a component of an unknown kind
        raise PluginError(f"{describe(broken[0])} cannot be used: {unusable(broken[0])}")
    names = sorted({record.name for record in lookup.list() if record.kind in KINDS})
    failures = "; ".join(f"{describe(r)}: {r.reason}" for r in lookup.list() if r.kind == "plugin")
    raise PluginError(
        f"no component is named {text!r}{did_you_mean(base_name, names)}; there are {', '.join(names)}"
        + (f"; plugins that cannot be used: {failures}" if failures else "")
    )
