"""Read the configuration of a run from a TOML file.

The keys are checked against the keywords, and components become choices.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agglo_core.agglomeration.keywords import COMPONENT_LISTS, COMPONENTS, NAMES, Choice
from agglo_core.errors import FileError
from agglo_core.registry.code_options import mark_texts
from agglo_core.registry.toml_files import read_toml
from agglo_core.suggestions import did_you_mean


def read_run_file(path: Path, *, allow_code: bool = False) -> dict[str, Any]:
    """Read the keywords of a run, including its component choices, from a TOML file.

    Parameters
    ----------
    path : Path
    allow_code : bool
        Whether the file may contain options that name code. Such code is imported and run.

    Raises
    ------
    FileError
        If the file cannot be read or parsed, has an unknown key, or has a value of another type where a
        component or a list of components is expected.
    """
    # 1. Read the table, and check its keys.
    table = read_toml(path)
    unknown = sorted(set(table) - set(NAMES))
    if unknown:
        hint = did_you_mean(unknown[0], NAMES)
        raise FileError(f"{path}: unknown key {unknown[0]!r}{hint}; accepted: {', '.join(NAMES)}")

    def choice(key: str, value: Any) -> Choice:
        if isinstance(value, str):
            return value
        if isinstance(value, Mapping) and isinstance(value.get("name"), str):
            options = {option: item for option, item in value.items() if option != "name"}
            return value["name"], options if allow_code else mark_texts(options)
        raise FileError(f"{path}: {key} must be a name or a table with a name, given {value!r:.60}")

    # 2. Convert components, single or in lists, to choices.
    keywords = {key: table[key] for key in NAMES if key in table}
    for key in COMPONENTS:
        if key in COMPONENT_LISTS and key in keywords:
            if not isinstance(keywords[key], list):
                raise FileError(f"{path}: {key} must be a list, given {keywords[key]!r:.60}")
            keywords[key] = tuple(choice(key, item) for item in keywords[key])
        elif key in keywords:
            keywords[key] = choice(key, keywords[key])
    return keywords
