"""From a mesh or graph to a hierarchy: a run of chosen components, until every goal is met.

Names are listed in the stub beside this file and imported when first used, so that the command line reads
``keywords`` without anything numerical.
"""

from __future__ import annotations

from pathlib import Path

from agglo_core.lazy_names import import_name, names_in_stub

_STUB = Path(__file__).with_suffix(".pyi")

__all__ = sorted(names_in_stub(_STUB))


def __getattr__(name: str) -> object:
    return import_name(__name__, _STUB, name)
