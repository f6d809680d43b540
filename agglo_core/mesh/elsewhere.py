"""Conveniences of meshes and graphs that packages further on make, as ``mesh.graph``: found when used."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

__all__ = ["made_by"]


def made_by(target: str) -> Callable[..., Any]:
    """The function ``"module:name"``, imported now; nothing here knows what it is."""
    module, _, name = target.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function
