"""Import the module of a component a second time, so that it starts without cached state."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import module_from_spec

from agglo_core.conformance.base import Subject
from agglo_core.registry.containment import PLUGIN_FAILURES


@contextmanager
def import_again(subject: Subject) -> Iterator[Subject]:
    """Yield the component with its module imported again, without caches and changed class attributes.

    The component is yielded unchanged for objects, and for modules that cannot be imported twice.
    """
    target = subject.target
    module, name = str(getattr(target, "__module__", "")), str(getattr(target, "__qualname__", "<"))
    original = sys.modules.get(module)
    spec = getattr(original, "__spec__", None)
    # Objects, local classes and modules without a loader cannot be imported again.
    if original is None or spec is None or spec.loader is None or "<" in name:
        yield subject
        return
    # Execute a second copy of the module and look up the component in it.
    try:
        module_copy = module_from_spec(spec)
        sys.modules[module] = module_copy
        try:
            spec.loader.exec_module(module_copy)
            component: object = module_copy
            for part in name.split("."):
                component = getattr(component, part)
        except PLUGIN_FAILURES:
            yield subject
            return
        yield _with_target(subject, f"{module}:{name}", component)
    finally:
        sys.modules[module] = original


def _with_target(subject: Subject, dotted: str, target: object) -> Subject:
    if subject.record is None or subject.record.component is None:
        return replace(subject, given=target)
    component = replace(subject.record.component, target=dotted)
    return replace(subject, record=replace(subject.record, component=component))
