"""Declarations of plugins: hooks, components and commands, with checks."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import pluggy

from agglo_core.registry.containment import shown
from agglo_core.registry.kinds import KINDS, PROMISES

CORE_COMMANDS: Final = (
    "demo",
    "run",
    "compare",
    "quality",
    "mesh",
    "solve",
    "formats",
    "plugins",
    "check",
    "completion",
)
"""Names of agglo's own commands, which plugins cannot use."""

hookspec = pluggy.HookspecMarker("agglo")
hookimpl = pluggy.HookimplMarker("agglo")
"""Decorator that marks a plugin function as one of agglo's hooks."""


@dataclass(frozen=True)
class Component:
    """Declaration of a component: kind, name, import path and properties.

    The component is imported only when it is used.

    Attributes
    ----------
    kind : str
        One of :data:`~agglo_core.registry.kinds.KINDS`.
    name : str
        An identifier of ASCII letters, digits and ``_`` by which users select the component.
    target : str
        ``"module:attribute"`` of the class (or factory); its keywords are the component's options.
    requires : tuple of str
        Top-level modules that must be importable, as in ``import NAME``.
    promises : mapping of str to bool or float
        Guaranteed properties, from :data:`~agglo_core.registry.kinds.PROMISES`.
    summary : str
        One line for listings.
    fallback : str, optional
        For a bisector with possibly one-sided output: the bisector that splits the piece instead.
    suffixes : tuple of str
        For a format: its file suffixes, in lower case with their dot, so that it is imported only for
        such files. A format without declared suffixes is built to read its attribute ``suffixes``.
    magic : str
        For a format with ``suffixes``: a regular expression of bytes (as Latin-1). Files with another suffix
        are also read if their first 512 bytes match.

    Examples
    --------
    >>> halves = agglo.Component("bisector", "halves", "agglo_halves.halves:Halves")
    >>> halves.kind, halves.name
    ('bisector', 'halves')
    """

    kind: str
    name: str
    target: str
    requires: tuple[str, ...] = ()
    promises: Mapping[str, bool | float] = field(default_factory=dict, hash=False)
    summary: str = ""
    fallback: str | None = None
    suffixes: tuple[str, ...] = ()
    magic: str = ""


@dataclass(frozen=True)
class Command:
    """Declaration of a subcommand of ``agglo``. Its ``target`` is a click command, imported when it runs.

    Examples
    --------
    >>> agglo.Command("hilbert", "agglo_hilbert.command:hilbert", summary="Draw the curve.").name
    'hilbert'
    """

    name: str
    target: str
    summary: str = ""


class Hooks:
    """Functions that agglo calls in a plugin, if it defines them.

    Each is optional, at least one is expected.
    """

    @hookspec
    def agglo_components(self) -> list[Component]:
        """Return the plugin's components."""
        raise NotImplementedError

    @hookspec
    def agglo_commands(self) -> list[Command]:
        """Return the plugin's commands for the command line."""
        raise NotImplementedError

    @hookspec
    def agglo_level_done(self, info: Mapping[str, Any]) -> None:
        """Receive progress after each depth of a recursion: ``depth``, ``pieces``, ``cells``."""


_DOTTED = r"[^\W\d]\w*(\.[^\W\d]\w*)*"
_TARGET = re.compile(f"{_DOTTED}:{_DOTTED}")
_MODULE = re.compile(_DOTTED)
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")  # no look-alikes of reserved names
_COMMAND = re.compile(r"[a-z][a-z0-9_-]*")


def faults(declared: Component | Command) -> Iterator[str]:
    """Yield the faults of a declared component or command, each with the accepted values."""
    if not isinstance(declared.target, str) or not _TARGET.fullmatch(declared.target):
        yield f"target {shown(declared.target)} is not of the form 'module:attribute'"
    if not isinstance(declared.summary, str):
        yield f"summary {shown(declared.summary)} is not a string"
    elif any(unicodedata.category(c) in ("Cc", "Cf") and c not in "\n\t" for c in declared.summary):
        yield f"summary {shown(declared.summary)} contains control characters"
    if isinstance(declared, Component):
        yield from _component_faults(declared)
    elif not isinstance(declared.name, str) or not _COMMAND.fullmatch(declared.name):
        yield f"command name {shown(declared.name)} may only contain lower-case letters, digits, '-' and '_'"


def _component_faults(component: Component) -> Iterator[str]:
    """Yield the faults in the declaration of a component, as sentences."""
    if component.kind not in KINDS:
        yield f"unknown kind {shown(component.kind)}; accepted: {', '.join(KINDS)}"
    name = component.name
    if not isinstance(name, str) or not _NAME.fullmatch(name) or name.lower() == "none":
        yield f"name {shown(name)} is not an identifier (a-z, A-Z, 0-9, '_'; 'none' means no component)"
    # Requirements are module names, checked without an import.
    requires = component.requires
    if not isinstance(requires, tuple | list) or not all(isinstance(r, str) and r for r in requires):
        yield f"requires {shown(requires)} is not a tuple of module names"
    else:
        yield from (
            f"requires {shown(r)}, expected a module name as in 'import NAME'; declare "
            "versions in the dependencies of the distribution"
            for r in requires
            if not _MODULE.fullmatch(r)
        )
    if component.fallback is not None and component.kind != "bisector":
        yield "fallback applies to bisectors only"
    if not isinstance(component.fallback, str | None):
        yield f"fallback {shown(component.fallback)} is not the name of a bisector"
    yield from _suffix_faults(component)
    yield from _magic_faults(component)
    # Promises.
    if not isinstance(component.promises, Mapping):
        yield f"promises {shown(component.promises)} is not a mapping of promise to bool or number"
        return
    for promise, value in component.promises.items():
        if promise not in PROMISES:
            yield f"unknown promise {shown(promise)}; accepted: {', '.join(PROMISES)}"
        elif not isinstance(value, bool | int | float):
            yield f"promise {promise!r} is {shown(value)}, expected a bool or a number"


def _suffix_faults(component: Component) -> Iterator[str]:
    suffixes = component.suffixes
    if not isinstance(suffixes, tuple):
        yield f"suffixes {shown(suffixes)} is not a tuple such as ('.vtu',)"
        return
    if suffixes and component.kind != "format":
        yield "suffixes applies to formats only"
    for suffix in suffixes:
        if not is_suffix(suffix):
            yield f"suffix {shown(suffix)} must be a dot and lower-case characters, such as '.vtu'"


def _magic_faults(component: Component) -> Iterator[str]:
    if component.magic and not component.suffixes:
        yield "magic applies to formats with declared suffixes only"
    try:
        re.compile(component.magic.encode("latin-1"))
    except (AttributeError, UnicodeEncodeError, re.error) as error:
        yield f"magic {shown(component.magic)} is not a regular expression of bytes: {error}"


def is_suffix(suffix: object) -> bool:
    """Return True for a file suffix in lower case with its dot."""
    return isinstance(suffix, str) and suffix[:1] == "." and len(suffix) > 1 and suffix == suffix.lower()


def make_plain(declared: Component | Command) -> Component | Command:
    """Convert all values in a faulty declaration to strings, so that it can be listed."""
    name, target, summary = map(_text, (declared.name, declared.target, declared.summary))
    if isinstance(declared, Command):
        return Command(name, target, summary)
    return Component(_text(declared.kind), name, target, summary=summary)


def _text(value: object) -> str:
    return str.__str__(value) if isinstance(value, str) else shown(value)
