"""Describe a component as JSON data, so that another process can import it."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from agglo_core.conformance.base.subject import Subject, subject_of
from agglo_core.errors import OptionError
from agglo_core.registry import Component
from agglo_core.registry.option_types import Text


def environment() -> dict[str, str]:
    """Return environment variables that give a child process the import path of this process."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}


def task_of(subject: Subject) -> dict[str, Any]:
    """Describe the component under test as JSON data, from which another process can import it.

    Raises
    ------
    OptionError
        If the component is an object, which another process cannot import.
    """
    texts = [name for name, value in subject.options.items() if isinstance(value, Text)]
    task: dict[str, Any] = {"kind": subject.kind, "texts": texts}
    task |= {"options": dict(subject.options), "promises": dict(subject.declared)}
    task["thorough"] = subject.thorough
    # Prefer the registered name, then the declaration, then the import path of the class.
    record, target = subject.record, subject.given
    if record is not None and record.component is not None:
        if record.distribution and subject.registry is None:
            return task | {"name": f"{record.distribution}/{record.name}"}
        return task | {"component": asdict(record.component)}
    if hasattr(target, "__qualname__") and "<" not in target.__qualname__ and target.__module__ != "__main__":
        return task | {"target": [target.__module__, target.__qualname__]}
    raise OptionError(
        "a timeout requires a component name, a declaration or an importable class, given an object"
    )


def subject_from(task: Mapping[str, Any]) -> Subject:
    """Import the component described by :func:`task_of`, for a test in this process."""
    component: Any = task.get("name")
    if "component" in task:
        lists = {name: tuple(task["component"][name]) for name in ("requires", "suffixes")}
        component = Component(**task["component"] | lists)
    if "target" in task:
        module, qualname = task["target"]
        component = importlib.import_module(module)
        for part in qualname.split("."):
            component = getattr(component, part)
    options = task["options"] | {name: Text(task["options"][name]) for name in task["texts"]}
    subject = subject_of(component, task["kind"], options=options, promises=task["promises"])
    return replace(subject, thorough=task["thorough"])
