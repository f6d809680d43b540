"""The TOML file of a run: reading it, checking its keys, and turning its components into choices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from agglo_core.agglomeration.choices import Choice
from agglo_core.errors import FileError
from agglo_core.registry.code_options import written
from agglo_core.registry.toml_files import read_toml

COMPONENTS = ("bisector", "fixer")
COMPONENT_LISTS = ("refiners", "post_refiners", "constraints")


class RunFile:
    """Values of a TOML file by key.

    Parameters
    ----------
    path : Path
    known : sequence of str
        The keys it may have.
    allow_code : bool
        Whether options that name code may stand in it; the code is then imported and run.

    Raises
    ------
    FileError
        If the file cannot be read or parsed, or has an unknown key.
    """

    def __init__(self, path: Path, known: Sequence[str], *, allow_code: bool = False) -> None:
        self._path, self._allow_code = path, allow_code
        self._table = read_toml(path)
        unknown = sorted(set(self._table) - set(known))
        if unknown:
            raise FileError(f"{path}: unknown key {unknown[0]!r}; accepted: {', '.join(known)}")

    def read(self, key: str, default: Any) -> Any:
        """The value of a key, or ``default``; components are turned into choices.

        Raises
        ------
        FileError
            If it is not a component, or list of components, where there should be one.
        """
        if key not in self._table:
            return default
        value = self._table[key]
        if key in COMPONENTS:
            return self._choice(key, value)
        if key in COMPONENT_LISTS:
            if not isinstance(value, list):
                raise FileError(f"{self._path}: {key} must be a list, given {value!r:.60}")
            return tuple(self._choice(key, each) for each in value)
        return value

    def _choice(self, key: str, value: Any) -> Choice:
        if isinstance(value, str):
            return value
        if isinstance(value, Mapping) and isinstance(value.get("name"), str):
            options = {option: each for option, each in value.items() if option != "name"}
            return value["name"], options if self._allow_code else written(options)
        raise FileError(f"{self._path}: {key} must be a name or a table with a name, not {value!r:.60}")
