"""Agglomerate a mesh or graph into a hierarchy of coarse levels.

The stub beside this file lists the public names. Each name is imported on first use, so that the command line
reads ``keywords`` without numerical packages.
"""

from __future__ import annotations

from pathlib import Path

from agglo_core.lazy_names import import_name, names_in_stub

_STUB = Path(__file__).with_suffix(".pyi")

__all__ = sorted(names_in_stub(_STUB))


def __getattr__(name: str) -> object:
    return import_name(__name__, _STUB, name)
