"""A component as a program meets it that has never used it: its module imported once more, and let go."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import module_from_spec

from agglo_core.conformance.base.subject import Subject
from agglo_core.registry.containment import PLUGIN_FAILURES


@contextmanager
def imported_again(subject: Subject) -> Iterator[Subject]:
    """The subject with what its module keeps (caches, attributes of classes) as after its first import.

    The subject itself where its module cannot be imported twice, and for an object that was handed over.
    """
    target = subject.target
    module, name = str(getattr(target, "__module__", "")), str(getattr(target, "__qualname__", "<"))
    before = sys.modules.get(module)
    spec = getattr(before, "__spec__", None)
    if before is None or spec is None or spec.loader is None or "<" in name:
        yield subject
        return
    try:
        again = module_from_spec(spec)
        sys.modules[module] = again
        try:
            spec.loader.exec_module(again)
            found: object = again
            for part in name.split("."):
                found = getattr(found, part)
        except PLUGIN_FAILURES:
            yield subject
            return
        yield _with_target(subject, f"{module}:{name}", found)
    finally:
        sys.modules[module] = before


def _with_target(subject: Subject, dotted: str, target: object) -> Subject:
    if subject.record is None or subject.record.component is None:
        return replace(subject, given=target)
    component = replace(subject.record.component, target=dotted)
    return replace(subject, record=replace(subject.record, component=component))
