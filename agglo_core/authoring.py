"""The one module plugin authors import from: everything a component, a command or a declaration needs.

Names are listed in the stub beside this file and imported when first used. They are kept from version to
version; our own plugins import nothing else.
"""

from __future__ import annotations

from pathlib import Path

from agglo_core.lazy_names import import_name, names_in_stub

_STUB = Path(__file__).with_suffix(".pyi")

__all__ = sorted(names_in_stub(_STUB))


def __getattr__(name: str) -> object:
    return import_name(__name__, _STUB, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
