"""Import functions on first use for methods such as ``mesh.plot``, from packages built on this one."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def import_function(target: str) -> Callable[..., Any]:
    """Import and return the function ``"module:name"`` at call time."""
    module, _, name = target.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function
