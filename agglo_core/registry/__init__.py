"""Plugins: what a package declares, and the registry that finds, explains and builds components.

A distribution joins by the entry-point group ``agglo``: each entry point names a light *declaration*
module (or object) whose hooks return records::

    from agglo_core import Component, hookimpl

    @hookimpl
    def agglo_components():
        return [Component(kind="bisector", name="halves", target="my_package.halves:Halves")]

Listing components imports the declarations and nothing else; the target is imported when it is built.
A plugin that is broken, lacks a package or clashes with another never takes the program down: it is
listed with its state and the reason, and using it raises :class:`~agglo_core.errors.PluginError`.

**Installing a plugin runs its code**: its declaration module is imported whenever agglo looks for
components. ``AGGLO_BLOCK=a,b`` keeps plugins from being imported, ``AGGLO_ONLY=a,b`` keeps all others
out, ``AGGLO_TRACE=1`` writes each loading, build and hook call to stderr.
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
