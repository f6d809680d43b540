"""Import of a module's public names on first use, as listed in its stub file (``.pyi``)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType

_STATEMENT = re.compile(r"^from ([\w.]+) import (?:\(([^)]*)\)|(.*))", re.MULTILINE)
_NAME = re.compile(r"(\w+) as \w+")
_ALIAS = re.compile(r"^(\w+) = (\w+)", re.MULTILINE)


@cache
def names_in_stub(file: Path) -> Mapping[str, tuple[str, str]]:
    """Return for each name in a ``.pyi`` file the module that defines it, and its name there.

    The stub holds statements ``from module import name as name``, which type checkers treat as public, and
    ``alias = name`` for renamed objects.
    """
    text = file.read_text(encoding="utf-8")
    statements = [(module, many or one) for module, many, one in _STATEMENT.findall(text)]
    homes = {name: (module, name) for module, names in statements for name in _NAME.findall(names)}
    return MappingProxyType(homes | {alias: homes[name] for alias, name in _ALIAS.findall(text)})


def import_name(importer: str, file: Path, name: str) -> object:
    """Import the object that the stub ``file`` of a module lists under this name.

    Raises
    ------
    AttributeError
        If the stub has no such name.
    """
    names = names_in_stub(file)
    if name not in names:
        raise AttributeError(f"module {importer!r} has no attribute {name!r}")
    module, original = names[name]
    if module != importer:
        home = import_module(module)
        if hasattr(home, original):
            return getattr(home, original)
    return import_module(f"{module}.{original}")  # the name is a module
