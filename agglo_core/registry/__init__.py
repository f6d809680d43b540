"""Plugins: their declarations, and the registry that finds, lists and builds components.

A distribution joins through the entry-point group ``agglo``: each entry point refers to a light *declaration*
module (or object) whose hooks return records::

    from agglo_core import Component, hookimpl

    @hookimpl
    def agglo_components():
        return [Component(kind="bisector", name="halves", target="my_package.halves:Halves")]

To list components, only the declarations are imported; a target is imported at the first build. A broken
or conflicting plugin, or a plugin without a required package, never stops the program: the listing shows
its state and the reason, and its use raises :class:`~agglo_core.errors.PluginError`.

**Installing a plugin runs its code**: agglo imports the declaration module whenever it searches for
components. ``AGGLO_BLOCK=a,b`` prevents the import of these plugins, ``AGGLO_ONLY=a,b`` the import of all
others, and ``AGGLO_TRACE=1`` writes each load, build and hook call to stderr.
"""

from agglo_core.registry.catalogue import Registry, default
from agglo_core.registry.declarations import CORE_COMMANDS, Command, Component, hookimpl
from agglo_core.registry.kinds import KINDS, PROMISES, Kind
from agglo_core.registry.records import Record, State, describe

__all__ = [
    "CORE_COMMANDS",
    "KINDS",
    "PROMISES",
    "Command",
    "Component",
    "Kind",
    "Record",
    "Registry",
    "State",
    "default",
    "describe",
    "hookimpl",
]
