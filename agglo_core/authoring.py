"""Interface for plugin authors in one module: components, commands and declarations.

The stub beside this file lists the names, which are imported on first use. The names are stable between
versions. Other names of the package, which agglo's own plugins import from their modules, may change.
"""

from __future__ import annotations

from pathlib import Path

from agglo_core.lazy_names import import_name, names_in_stub

_STUB = Path(__file__).with_suffix(".pyi")

__all__ = sorted(names_in_stub(_STUB))


def __getattr__(name: str) -> object:
    return import_name(__name__, _STUB, name)


def __dir__() -> list[str]:
    return list(__all__)
