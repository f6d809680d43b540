"""Import functions of later packages for methods such as ``mesh.plot``, on first use."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any


def import_function(target: str) -> Callable[..., Any]:
    """Import and return the function ``"module:name"`` of a later package."""
    module, _, name = target.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function
