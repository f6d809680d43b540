"""Methods of meshes and graphs, as ``mesh.graph``, that later packages implement: imported when used."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

__all__ = ["made_by"]


def made_by(target: str) -> Callable[..., Any]:
    """The function ``"module:name"``, imported now, so that this package does not depend on it."""
    module, _, name = target.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function
